# What differs between the versions of Godot: this file is for Godot 4, godot3/platform.gd has the same for Godot 3.
extends RefCounted


# Monotonic clock, s.
static func now_s():
	return Time.get_ticks_usec() * 1e-6


# Value of a JSON text; null where it is not valid.
static func json_value(text):
	var parser = JSON.new()
	return parser.data if parser.parse(text) == OK else null


# JSON with all digits of numbers.
static func json_text(value):
	return JSON.stringify(value, "", false, true)


static func connect_http(client, host, port, secure):
	return client.connect_to_host(host, port, TLSOptions.client() if secure else null)


# Numbers of little-endian bytes.
static func float32s(content, begin, end):
	return content.slice(begin, end).to_float32_array()


static func float64s(content, begin, end):
	return content.slice(begin, end).to_float64_array()


static func slice(content, begin, end):
	return content.slice(begin, end)


# Set the rotation and position of a bone relative to its parent.
static func pose_bone(skeleton, bone, rotation, position):
	skeleton.set_bone_pose_rotation(bone, rotation)
	skeleton.set_bone_pose_position(bone, position)


# Set the rotation of a bone relative to its parent; the position stays that of the rest pose.
static func rotate_bone(skeleton, bone, rotation):
	skeleton.set_bone_pose_rotation(bone, rotation)


static func rotation_of(basis):
	return basis.get_rotation_quaternion()


static func quaternion(x, y, z, w):
	return Quaternion(x, y, z, w)


# Position of a joint in the skeleton's space.
static func bone_position(skeleton, bone):
	return skeleton.get_bone_global_pose(bone).origin


# The pose after a bone was added is its rest.
static func rest_bone(skeleton, bone):
	skeleton.reset_bone_pose(bone)
