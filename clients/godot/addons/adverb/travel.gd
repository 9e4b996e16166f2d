# Roots that travel by steps in a turning frame (docs/math.md).
extends RefCounted

const Numbers = preload("numbers.gd")

var _strides
var _weights
var _looping
var _intervals


# `strides`: K × N × 4: sideways, forward (m), turn (rad), rise (m).
func _init(strides, weights, looping):
	_strides = strides
	_weights = weights
	_looping = looping
	_intervals = strides.size() / (4 * weights.size())


# [x, z, heading, height] at an unwrapped phase (1.5 is the middle of the second cycle), from the origin.
func place_at(phase):
	var place = [0.0, 0.0, 0.0, 0.0]
	var start = 0
	if _looping and phase >= 2.0:
		start = int(floor(phase))
		var once = [0.0, 0.0, 0.0, 0.0]
		_walk(0, 1.0, once)
		for _k in range(start):
			_follow(once, place)
	_walk(start, phase, place)
	return place


# Whole cycles have the displacement of the first.
func _follow(once, place):
	var cosine = cos(place[2])
	var sine = sin(place[2])
	place[0] += once[0] * cosine + once[1] * sine
	place[1] += -once[0] * sine + once[1] * cosine
	place[2] += once[2]
	place[3] += once[3]


func _walk(start, end, place):
	var at = float(start * _intervals)
	var stop = end * _intervals
	if at >= stop - 1e-12:
		return
	var k = int(floor(at + 1e-12))
	var step = _step(k)
	var before = _step(k - 1) if _looping or k > 0 else step
	while at < stop - 1e-12:
		var upto = Numbers.least(k + 1.0, stop)
		var after = _step(k + 1) if _looping or k < _intervals - 1 else step
		var u = Numbers.bounded(at - k, 0.0, 1.0)
		var v = Numbers.bounded(upto - k, 0.0, 1.0)
		var part = []
		for a in range(4):
			part.append(_covered(v, step[a], before[a], after[a]) - _covered(u, step[a], before[a], after[a]))
		var middle = place[2] + 0.5 * part[2]
		place[0] += part[0] * cos(middle) + part[1] * sin(middle)
		place[1] += part[1] * cos(middle) - part[0] * sin(middle)
		place[2] += part[2]
		place[3] += part[3]
		before = step
		step = after
		at = upto
		k += 1


# Blended step of an interval, which wraps around.
func _step(k):
	var row = int(fposmod(k, _intervals))
	var found = [0.0, 0.0, 0.0, 0.0]
	for i in range(_weights.size()):
		var at = 4 * (row * _weights.size() + i)
		for a in range(4):
			found[a] += _weights[i] * _strides[at + a]
	return found


# Part of a step covered at u in 0 to 1: a cubic whose ends share their neighbours' mean speed.
func _covered(u, step, before, after):
	var v = 1.0 - u
	return u * u * (3.0 - 2.0 * u) * step + u * v * (v * 0.5 * (before + step) - u * 0.5 * (step + after))
