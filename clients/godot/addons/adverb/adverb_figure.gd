# A skeleton of the scene that performs a verb of a server.
class_name AdverbFigure
extends Node3D

const Rig = preload("rig.gd")
const Stream = preload("stream.gd")

# Something that the stream reports: {kind, …}, see Session.events.
signal reported(event)

# Address of the server: http:// or https://, host and port, and the path where a proxy gives it one.
@export var server: String = "http://127.0.0.1:8000"
# Key; empty where the server requires none.
@export var key: String = ""
@export var verb: String = "reach"
# Method of the verb; empty: that of the server.
@export var method: String = ""
# All adverbs of the verb by name, at the start; empty: the middle of the domain.
@export var adverbs: Dictionary = {}
# The skeleton; by default a child of this node. An empty one gets the bones of the verb.
@export var skeleton: NodePath
# Goal of verbs with the adverbs x, y, z, which the hand or foot meets. May be empty.
@export var goal: NodePath
# Names of bones by joint, where they differ by more than case and a prefix.
@export var joint_map: Dictionary = {}
# Frames per second that are received.
@export var fps: int = 60
@export var encoding: String = "q48"
@export var speed: float = 1.0
# Phase at the start, 0 to 1.
@export var phase: float = 0.0
# Whether the motion plays; otherwise the figure holds the phase and follows its goal.
@export var play: bool = true

# The stream, for further channels and settings; see stream.gd.
var stream = null
# Number of the channel.
var channel = -1
# The displayed pose, see JitterBuffer.sample; null before the first frame.
var pose = null

var _rig = null
var _opened = ""
var _aimed = []


func _enter_tree():
	_rig = null
	_opened = ""
	pose = null
	stream = Stream.new(server, key)
	var options = {"fps": fps, "encoding": encoding, "speed": speed, "phase": phase, "play": play}
	if method != "":
		options["method"] = method
	if adverbs.size() > 0:
		options["adverbs"] = adverbs
	channel = stream.session.open(verb, options)


func _process(_delta):
	if stream == null:
		return
	stream.poll()
	for event in stream.take_events():
		emit_signal("reported", event)
		if event["kind"] == "error" or event["kind"] == "closed":
			push_warning("Adverb: %s: %s" % [event["code"], event["detail"]])
	if not stream.session.channels.has(channel):
		return
	var info = stream.session.channels[channel].info
	if info.size() == 0:
		return
	if (_rig == null or info["verb"] != _opened) and not _match(info):
		return
	_aim(info)
	pose = stream.sample(channel)
	if pose != null and pose["values"].size() == 3 + 4 * info["skeleton"]["names"].size():
		_rig.apply(pose["values"])


func _exit_tree():
	if stream != null:
		stream.close()
		stream = null


# Continue with another verb, without a jump. Options: adverbs, method, phase, transition_s.
func switch_to(name, options = {}):
	if _is_open():
		stream.session.switch_to(channel, name, options)


# Change settings: adverbs, speed, phase, play, loop, fps, half_life, follow, priority.
func change(settings):
	if _is_open():
		stream.session.change(channel, settings)


func _is_open():
	if stream == null:
		push_warning("Adverb: %s is not in the scene" % get_name())
	return stream != null


# The skeleton that is driven; null where there is none.
func target():
	if not skeleton.is_empty():
		return get_node_or_null(skeleton)
	for child in get_children():
		if child is Skeleton3D:
			return child
	return null


# Prepare the skeleton for a verb; false where there is none.
func _match(info):
	var found = target()
	if found == null:
		if _opened == "":
			push_warning("Adverb: %s has no skeleton" % get_name())
		_opened = info["verb"]
		return false
	if found.get_bone_count() == 0:
		Rig.build(found, info["skeleton"])
	_rig = Rig.new(found, info["skeleton"], joint_map)
	_opened = info["verb"]
	_aimed = []
	return true


# Send a goal that differs from the last one.
func _aim(info):
	var node = get_node_or_null(goal)
	var names = []
	for row in info["adverbs"]:
		names.append(row["name"])
	if node == null or names != ["x", "y", "z"]:
		return
	var point = target().global_transform.affine_inverse() * node.global_transform.origin / _rig.scale
	var values = [point.x, point.y, point.z]
	if values != _aimed and stream.session.aim(channel, values):
		_aimed = values
