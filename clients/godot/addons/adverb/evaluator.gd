# Evaluation of a verb file without a server: weights and phase, or adverbs by `rbf` or `refined`, to poses.
#
# The poses are those of the server with `plant: false`.
extends RefCounted

const Cardinal = preload("basis.gd")
const Numbers = preload("numbers.gd")
const Rotations = preload("rotations.gd")
const TimeWarp = preload("time_warp.gd")
const Travel = preload("travel.gd")
const VerbFile = preload("verb_file.gd")

const SHORTEST = 0.3

# Why the file cannot be evaluated; empty where it can.
var problem = ""
# JSON value of the file: name, adverbs, joints, examples, …
var facts = {}

var _basis
var _curves
var _intervals
var _looping
var _vectors
var _references
var _strides = []
var _phases
var _log_lengths
var _parents
var _offsets
var _sums = []


# Read a verb file, as GET /v1/verbs/{verb}/artifact gives it.
func _init(content):
	var file = VerbFile.new(content)
	if file.problem == "":
		_read(file)
	problem = file.problem
	facts = file.facts


func _read(file):
	facts = file.facts
	var count = facts["examples"].size()
	var joints = facts["joints"].size()
	_curves = file.numbers("curves", [-1, count, 4 + 4 * joints])
	_intervals = int(_curves.size() / (count * (4 + 4 * joints))) - 3
	_looping = facts["looping"]
	_vectors = int(facts["rotation_mode"]) == 1
	_references = file.numbers("references", [joints, 4])
	_phases = file.numbers("phases", [facts["keytime_names"].size()])
	_log_lengths = TimeWarp.log_lengths_of(file.numbers("keytimes", [count, _phases.size()]), _phases.size())
	_parents = file.numbers("skeleton.parents", [joints])
	_offsets = file.numbers("skeleton.offsets", [joints, 3])
	if int(facts["root_motion"]) == 1:
		var planar = file.numbers("strides", [_intervals, count, 3])
		var rises = file.numbers("rises", [_intervals, count]) if file.has("rises") else []
		for k in range(planar.size() / 3):
			for a in range(3):
				_strides.append(planar[3 * k + a])
			_strides.append(rises[k] if rises.size() > 0 else 0.0)
	_basis = Cardinal.new(file)


# {weights, clamped} at adverbs in the verb's order; method `rbf` or `refined`.
func weights_at(adverbs, method):
	return _basis.weights(adverbs, method)


# Pose of weights at a phase, 0 to 1, and beyond in further cycles of a loop: {phase, time_s, duration_s, values} with
# values as in records.
func pose_of(weights, phase):
	return _pose(weights, TimeWarp.new(_phases, _log_lengths, _looping, weights), phase)


# Pose of weights at seconds from the start.
func pose_at_time(weights, time_s):
	var clock = TimeWarp.new(_phases, _log_lengths, _looping, weights)
	var cycles = floor(time_s / clock.duration_s) if _looping else 0.0
	var rest_s = Numbers.bounded(time_s - cycles * clock.duration_s, 0.0, clock.duration_s)
	return _pose(weights, clock, clock.phase_at(rest_s) + cycles)


# {positions, rotations} of all joints, see Rotations.solve.
func solve(values):
	return Rotations.solve(_parents, _offsets, values)


func _pose(weights, clock, phase):
	var cycles = floor(phase) if _looping else 0.0
	var values = _blend(weights, phase - cycles)
	if _strides.size() > 0:
		_travel(weights, phase, values)
	return {
		"phase": phase,
		"time_s": clock.time_at(phase - cycles) + cycles * clock.duration_s,
		"duration_s": clock.duration_s,
		"values": values
	}


# Move a pose, whose root has a height and no heading, to its position in the world.
func _travel(weights, phase, values):
	var place = Travel.new(_strides, weights, _looping).place_at(phase)
	values[0] = place[0]
	values[1] += place[3]
	values[2] = place[1]
	Rotations.multiply(values, 3, [0.0, sin(0.5 * place[2]), 0.0, cos(0.5 * place[2])], 0, values, 3)


# Root x, y, z and x, y, z, w per joint of weights at a phase in 0 to 1.
func _blend(weights, phase):
	_sum(weights, phase)
	var values = [_sums[0], _sums[1], _sums[2]]
	for q in range(4, _sums.size(), 4):
		if _vectors:
			_append_vector(values, q)
		else:
			_append_unit(values, q)
	return values


# Sum of the rows of the curves around a phase.
func _sum(weights, phase):
	var count = weights.size()
	var width = 4 + 4 * _parents.size()
	var x = phase * _intervals
	var k = int(Numbers.bounded(floor(x), 0, _intervals - 1))
	var u = x - k
	var v = 1.0 - u
	var taps = [
		v * v * v / 6.0, 2.0 / 3.0 - u * u + 0.5 * u * u * u, 2.0 / 3.0 - v * v + 0.5 * v * v * v, u * u * u / 6.0
	]
	var curves = _curves
	var sums = []
	for _column in range(width):
		sums.append(0.0)
	for t in range(4):
		for i in range(count):
			var weight = taps[t] * weights[i]
			if weight == 0.0:
				continue
			var at = ((k + t) * count + i) * width
			for column in range(width):
				sums[column] += weight * curves[at + column]
	_sums = sums


# A sum of quaternions that is too short becomes the reference of its joint.
func _append_unit(values, q):
	var length = sqrt(
		_sums[q] * _sums[q] + _sums[q + 1] * _sums[q + 1] + _sums[q + 2] * _sums[q + 2] + _sums[q + 3] * _sums[q + 3]
	)
	for a in range(4):
		values.append(_sums[q + a] / length if length >= SHORTEST else _references[q - 4 + a])


# Reference · exp(rotation vector).
func _append_vector(values, q):
	var angle = sqrt(_sums[q] * _sums[q] + _sums[q + 1] * _sums[q + 1] + _sums[q + 2] * _sums[q + 2])
	var scale = sin(0.5 * angle) / angle if angle > 1e-9 else 0.5
	var turn = [scale * _sums[q], scale * _sums[q + 1], scale * _sums[q + 2], cos(0.5 * angle)]
	for _a in range(4):
		values.append(0.0)
	Rotations.multiply(values, values.size() - 4, _references, q - 4, turn, 0)
