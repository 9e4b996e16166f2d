# Poses of a verb on a skeleton of the scene, by joint names and rest poses.
#
# Both stand in their rest poses with the same facing. A bone gets the global rotation of its joint, and keeps the
# direction that it has relative to the joint's limb at rest: its axes may be any, and lowered arms at rest become raised
# ones. Lengths stay those of the skeleton; the root is scaled by the heights of the hips.
extends RefCounted

const Numbers = preload("numbers.gd")
const Platform = preload("platform.gd")
const Rotations = preload("rotations.gd")

# Size of the skeleton relative to the verb's.
var scale = 1.0
# Number of bones with a joint.
var mapped = 0

var _skeleton
var _parents
var _offsets = []
# Joint of each bone; -1: none.
var _joints = []
# Rest poses of the bones in the skeleton's space, and what follows the global rotation of the joint.
var _rest = []
var _corrections = []
var _rotations = []


# `verb`: {names, parents, offsets}, as `skeleton` of a channel's info. `map`: names of bones by joint; names that are
# equal but for case and a prefix as `mixamorig:` need no entry.
func _init(skeleton, verb, map):
	_skeleton = skeleton
	_parents = verb["parents"]
	for offset in verb["offsets"]:
		for k in range(3):
			_offsets.append(offset[k])
	_find(verb["names"], map)
	var at_rest = []
	for k in range(3 + 4 * _parents.size()):
		at_rest.append(1.0 if k > 3 and (k - 3) % 4 == 3 else 0.0)
	var positions = Rotations.solve(_parents, _offsets, at_rest)["positions"]
	for bone in range(_joints.size()):
		_correct(bone, positions)
	_measure(positions)


# Make the bones of a verb in an empty skeleton, in the rest pose of the verb.
static func build(skeleton, verb):
	for joint in range(verb["names"].size()):
		skeleton.add_bone(verb["names"][joint])
		var parent = int(verb["parents"][joint])
		if parent >= 0:
			skeleton.set_bone_parent(joint, parent)
		var offset = verb["offsets"][joint]
		var origin = Vector3(offset[0], offset[1], offset[2]) if parent >= 0 else Vector3(0, 0, 0)
		skeleton.set_bone_rest(joint, Transform3D(Basis(), origin))
		Platform.rest_bone(skeleton, joint)


# Show a pose: root x, y, z, then x, y, z, w per joint.
func apply(values):
	var rotations = Rotations.solve(_parents, _offsets, values)["rotations"]
	var globals = []
	for bone in range(_joints.size()):
		var parent = _skeleton.get_bone_parent(bone)
		var above = globals[parent] if parent >= 0 else Transform3D()
		var rest = _skeleton.get_bone_rest(bone)
		var joint = _joints[bone]
		if joint < 0:
			globals.append(above * rest)
			continue
		var at = 4 * joint
		var rotation = Platform.quaternion(rotations[at], rotations[at + 1], rotations[at + 2], rotations[at + 3])
		var local = Platform.rotation_of(above.basis).inverse() * rotation * _corrections[bone]
		if joint == 0:
			var origin = above.affine_inverse() * (scale * Vector3(values[0], values[1], values[2]))
			Platform.pose_bone(_skeleton, bone, local, origin)
			globals.append(above * Transform3D(Basis(local), origin))
		else:
			Platform.rotate_bone(_skeleton, bone, local)
			globals.append(above * Transform3D(Basis(local), rest.origin))


func _find(names, map):
	var joints = {}
	for joint in range(names.size()):
		joints[map.get(names[joint], _plain(names[joint]))] = joint
	for bone in range(_skeleton.get_bone_count()):
		var name = _skeleton.get_bone_name(bone)
		_joints.append(joints.get(name, joints.get(_plain(name), -1)))
		mapped += 1 if _joints[bone] >= 0 else 0
		var parent = _skeleton.get_bone_parent(bone)
		var rest = _skeleton.get_bone_rest(bone)
		_rest.append(_rest[parent] * rest if parent >= 0 else rest)


# A name without prefix, case and signs.
func _plain(name):
	var plain = name.substr(name.rfind(":") + 1, name.length()).to_lower()
	for part in ["mixamorig", "_", "-", ".", " "]:
		plain = plain.replace(part, "")
	return plain


# The rotation that brings the bone's limb to the direction of the joint's, then the bone's rest rotation. A bone at the
# end, or with several limbs, rotates as the bone above it.
func _correct(bone, positions):
	var above = _mapped_parent(bone)
	var rotation = _rotations[above] if above >= 0 else Platform.quaternion(0.0, 0.0, 0.0, 1.0)
	var child = _only_child(bone)
	if _joints[bone] >= 0 and child >= 0:
		var from = _rest[child].origin - _rest[bone].origin
		var to = _point(positions, _joints[child]) - _point(positions, _joints[bone])
		rotation = _arc(from, to, rotation)
	_rotations.append(rotation)
	_corrections.append(rotation * Platform.rotation_of(_rest[bone].basis))


# Shortest rotation from one direction to another; `other` where one has no length, or they are opposite.
func _arc(from, to, other):
	if from.length() < 1e-6 or to.length() < 1e-6:
		return other
	var a = from.normalized()
	var b = to.normalized()
	var axis = a.cross(b)
	var w = 1.0 + a.dot(b)
	if w < 1e-4:
		return other
	return Platform.quaternion(axis.x, axis.y, axis.z, w).normalized()


func _point(positions, joint):
	return Vector3(positions[3 * joint], positions[3 * joint + 1], positions[3 * joint + 2])


# The bone of the nearest joint above; -1: none.
func _mapped_parent(bone):
	var parent = _skeleton.get_bone_parent(bone)
	while parent >= 0 and _joints[parent] < 0:
		parent = _skeleton.get_bone_parent(parent)
	return parent


# The only bone with a joint below a bone, with none in between; -1 if there are none or several.
func _only_child(bone):
	var found = -1
	for other in range(_joints.size()):
		if _joints[other] >= 0 and _mapped_parent(other) == bone:
			if found >= 0:
				return -1
			found = other
	return found


# Height of the skeleton's root above its lowest bone, relative to the verb's.
func _measure(positions):
	var root = _joints.find(0)
	if root < 0:
		return
	var theirs = 0.0
	var ours = 0.0
	for bone in range(_joints.size()):
		if _joints[bone] >= 0:
			theirs = Numbers.most(theirs, _rest[root].origin.y - _rest[bone].origin.y)
	for joint in range(_parents.size()):
		ours = Numbers.most(ours, -positions[3 * joint + 1])
	if theirs > 0.0 and ours > 0.0:
		scale = theirs / ours
