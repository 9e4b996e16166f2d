# Unit quaternions x, y, z, w inside arrays of numbers, in double precision.
extends RefCounted

const NEARLY_ONE = 0.9995


# out[o …] = a[i …] ∘ b[j …]: first b, then a. `out` may be `a` or `b`.
static func multiply(out, o, a, i, b, j):
	var ax = a[i]
	var ay = a[i + 1]
	var az = a[i + 2]
	var aw = a[i + 3]
	var bx = b[j]
	var by = b[j + 1]
	var bz = b[j + 2]
	var bw = b[j + 3]
	out[o] = aw * bx + ax * bw + ay * bz - az * by
	out[o + 1] = aw * by + ay * bw + az * bx - ax * bz
	out[o + 2] = aw * bz + az * bw + ax * by - ay * bx
	out[o + 3] = aw * bw - ax * bx - ay * by - az * bz


# Append the interpolation from a[i …] to b[i …] along the shorter arc; a share above 1 extrapolates.
static func append_slerp(out, a, b, i, share):
	var dot = a[i] * b[i] + a[i + 1] * b[i + 1] + a[i + 2] * b[i + 2] + a[i + 3] * b[i + 3]
	var from = 1.0 - share
	var to = share
	if abs(dot) < NEARLY_ONE:
		var angle = acos(abs(dot))
		var sine = sin(angle)
		from = sin(from * angle) / sine
		to = sin(to * angle) / sine
	if dot < 0.0:
		to = -to
	var x = from * a[i] + to * b[i]
	var y = from * a[i + 1] + to * b[i + 1]
	var z = from * a[i + 2] + to * b[i + 2]
	var w = from * a[i + 3] + to * b[i + 3]
	var length = sqrt(x * x + y * y + z * z + w * w)
	if not length > 0.0:
		for number in [0.0, 0.0, 0.0, 1.0]:
			out.append(number)
		return
	for number in [x, y, z, w]:
		out.append(number / length)


# Global positions (3 per joint, m) and rotations (4 per joint) of a pose: root x, y, z, then x, y, z, w per joint.
# `offsets` has 3 numbers per joint, in the parent's frame. Returns {positions, rotations}.
static func solve(parents, offsets, values):
	var count = parents.size()
	var positions = []
	var rotations = []
	positions.resize(3 * count)
	rotations.resize(4 * count)
	for joint in range(count):
		var parent = int(parents[joint])
		if parent < 0:
			for k in range(3):
				positions[3 * joint + k] = values[k]
			for k in range(4):
				rotations[4 * joint + k] = values[3 + 4 * joint + k]
			continue
		multiply(rotations, 4 * joint, rotations, 4 * parent, values, 3 + 4 * joint)
		_place(positions, joint, parent, rotations, offsets)
	return {"positions": positions, "rotations": rotations}


# Position of a joint: its offset, rotated by the parent, from the parent's position.
static func _place(positions, joint, parent, rotations, offsets):
	var x = rotations[4 * parent]
	var y = rotations[4 * parent + 1]
	var z = rotations[4 * parent + 2]
	var w = rotations[4 * parent + 3]
	var vx = offsets[3 * joint]
	var vy = offsets[3 * joint + 1]
	var vz = offsets[3 * joint + 2]
	var tx = 2.0 * (y * vz - z * vy)
	var ty = 2.0 * (z * vx - x * vz)
	var tz = 2.0 * (x * vy - y * vx)
	positions[3 * joint] = positions[3 * parent] + vx + w * tx + y * tz - z * ty
	positions[3 * joint + 1] = positions[3 * parent + 1] + vy + w * ty + z * tx - x * tz
	positions[3 * joint + 2] = positions[3 * parent + 2] + vz + w * tz + x * ty - y * tx
