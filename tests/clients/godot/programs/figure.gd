# The demo scene against a server: waits until the hand is on the goal, and prints positions of the bones. With `moves`
# the figure gets another parent once it is there, and has to reach its goal again.
extends SceneTree

const Platform = preload("res://addons/adverb/platform.gd")
const Rig = preload("res://addons/adverb/rig.gd")

const PATIENCE_S = 30.0

var _settings
var _scene
var _figure
var _poses = 0


func _initialize():
	_settings = JSON.parse(OS.get_environment("ADVERB_PROGRAM")).result
	_scene = load("res://demo/demo.tscn").instance()
	if not _settings["demo"]:
		_scene.set_script(null)
	_figure = _scene.get_node("Figure")
	_figure.server = _settings["server"]
	_figure.verb = _settings["verb"]
	_figure.method = _settings["method"]
	_figure.adverbs = _settings["adverbs"]
	_figure.play = false
	_figure.phase = _settings["phase"]
	var point = _settings["goal"]
	_scene.get_node("Goal").transform.origin = Vector3(point[0], point[1], point[2])
	if not _settings["demo"]:
		_figure.transform = Transform(Basis(Vector3(0, 1, 0), 0.5), Vector3(1, 0, 2))
	_scene.get_node("Goal").transform.origin = _figure.transform * _scene.get_node("Goal").transform.origin
	if _settings["other"]:
		_make_other(_figure.get_node("Skeleton"))
	root.add_child(_scene)


func _idle(_delta):
	OS.delay_msec(2)
	if _figure.pose != null:
		_poses += 1
	var skeleton = _figure.get_node("Skeleton")
	var bone = skeleton.find_bone(_settings["hand"])
	var distance = INF
	if _poses > 5 and bone >= 0:
		var point = skeleton.global_transform * Platform.bone_position(skeleton, bone)
		distance = point.distance_to(_scene.get_node("Goal").global_transform.origin)
	if distance > _settings["tolerance_m"] and OS.get_ticks_msec() < PATIENCE_S * 1000.0:
		return false
	if _settings["moves"]:
		_settings["moves"] = false
		_move()
		return false
	var positions = []
	for k in range(skeleton.get_bone_count()):
		var point = Platform.bone_position(skeleton, k)
		positions.append([point.x, point.y, point.z])
	var values = _figure.pose["values"] if _figure.pose != null else []
	var mesh = _scene.get_node("Lines").mesh
	var lines = mesh.surface_get_array_len(0) if mesh != null else 0
	print("JSON " + Platform.json_text({
		"distance": distance, "positions": positions, "values": values, "lines": lines,
		"goal": _figure.stream.session.channels[_figure.channel]._adverbs,
		"method": _figure.stream.session.channels[_figure.channel].info["method"]
	}))
	quit()
	return true


# Give the figure another parent, and its goal another place.
func _move():
	var parent = Spatial.new()
	root.add_child(parent)
	_scene.remove_child(_figure)
	_figure.change({"speed": 0.5})
	_figure.switch_to("locomotion")
	_figure.goal = NodePath("../../%s/Goal" % _scene.get_name())
	_scene.get_node("Goal").transform.origin += Vector3(0.03, 0.02, 0.0)
	parent.add_child(_figure)
	_poses = 0


# Bones with other names, other axes and 1.5 times the size; the arms hang down.
func _make_other(skeleton):
	var verb = _settings["skeleton"]
	var axes = Basis(Vector3(1, 2, 3).normalized(), 0.8)
	for joint in range(verb["names"].size()):
		skeleton.add_bone("rig_" + verb["names"][joint].to_upper())
		_figure.joint_map[verb["names"][joint]] = "rig_" + verb["names"][joint].to_upper()
		var parent = int(verb["parents"][joint])
		var offset = verb["offsets"][joint]
		var limb = 1.5 * Vector3(offset[0], offset[1], offset[2])
		if parent < 0:
			skeleton.set_bone_rest(joint, Transform(axes, Vector3(0, 1.5, 0)))
			continue
		skeleton.set_bone_parent(joint, parent)
		if verb["names"][joint] in _settings["lowered"]:
			limb = Vector3(0, -limb.length(), 0)
		skeleton.set_bone_rest(joint, Transform(Basis(), axes.inverse() * limb))
