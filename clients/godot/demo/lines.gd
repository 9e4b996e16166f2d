# Lines from each bone of a skeleton to its parent.
extends MeshInstance3D

const Platform = preload("../addons/adverb/platform.gd")


func draw(skeleton):
	var points = PackedVector3Array()
	for bone in range(skeleton.get_bone_count()):
		var parent = skeleton.get_bone_parent(bone)
		if parent >= 0:
			points.append(Platform.bone_position(skeleton, bone))
			points.append(Platform.bone_position(skeleton, parent))
	if points.size() == 0:
		return
	var arrays = []
	arrays.resize(Mesh.ARRAY_MAX)
	arrays[Mesh.ARRAY_VERTEX] = points
	var lines = ArrayMesh.new()
	lines.add_surface_from_arrays(Mesh.PRIMITIVE_LINES, arrays)
	mesh = lines
