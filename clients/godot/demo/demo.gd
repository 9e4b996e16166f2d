# The demo: the goal moves on a circle, and lines show the skeleton.
extends Node3D

var _time_s = 0.0


func _process(delta):
	_time_s += delta
	var goal = get_node("Goal")
	goal.transform.origin = Vector3(-0.25 + 0.15 * cos(_time_s), 1.2 + 0.2 * sin(_time_s), 0.4)
	get_node("Lines").draw(get_node("Figure").target())
