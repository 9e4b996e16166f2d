# What differs between the versions of Godot: this file is for Godot 3, addons/adverb/platform.gd has the same for
# Godot 4.
extends Reference


# Monotonic clock, s.
static func now_s():
	return OS.get_ticks_usec() * 1e-6


# Value of a JSON text; null where it is not valid.
static func json_value(text):
	var parsed = JSON.parse(text) if text != "" else null
	return parsed.result if parsed != null and parsed.error == OK else null


# JSON with all digits of numbers; JSON.print writes six.
static func json_text(value):
	match typeof(value):
		TYPE_DICTIONARY:
			var fields = []
			for name in value:
				fields.append(JSON.print(name) + ":" + json_text(value[name]))
			return "{" + PoolStringArray(fields).join(",") + "}"
		TYPE_ARRAY, TYPE_REAL_ARRAY, TYPE_STRING_ARRAY, TYPE_INT_ARRAY:
			var items = []
			for item in value:
				items.append(json_text(item))
			return "[" + PoolStringArray(items).join(",") + "]"
		TYPE_REAL:
			return "%.12f" % value
	return JSON.print(value)


static func connect_http(client, host, port, secure):
	return client.connect_to_host(host, port, secure)


# Numbers of little-endian bytes: the head of an encoded variant before them makes them an array.
static func float32s(content, begin, end):
	if begin >= end:
		return PoolRealArray()
	var stream = StreamPeerBuffer.new()
	stream.put_32(TYPE_REAL_ARRAY)
	stream.put_32((end - begin) / 4)
	var head = stream.data_array
	head.append_array(content.subarray(begin, end - 1))
	return bytes2var(head)


static func float64s(content, begin, end):
	var found = []
	var stream = StreamPeerBuffer.new()
	stream.data_array = content.subarray(begin, end - 1) if begin < end else PoolByteArray()
	for _k in range((end - begin) / 8):
		found.append(stream.get_double())
	return found


static func slice(content, begin, end):
	return content.subarray(begin, end - 1) if begin < end else PoolByteArray()


# Set the rotation and position of a bone relative to its parent.
static func pose_bone(skeleton, bone, rotation, position):
	var rest = skeleton.get_bone_rest(bone)
	skeleton.set_bone_pose(bone, rest.affine_inverse() * Transform(Basis(rotation), position))


# Set the rotation of a bone relative to its parent; the position stays that of the rest pose.
static func rotate_bone(skeleton, bone, rotation):
	pose_bone(skeleton, bone, rotation, skeleton.get_bone_rest(bone).origin)


static func rotation_of(basis):
	return basis.get_rotation_quat()


static func quaternion(x, y, z, w):
	return Quat(x, y, z, w)


# Position of a joint in the skeleton's space.
static func bone_position(skeleton, bone):
	return skeleton.get_bone_global_pose(bone).origin


# The pose after a bone was added is its rest.
static func rest_bone(skeleton, bone):
	skeleton.set_bone_pose(bone, Transform.IDENTITY)
