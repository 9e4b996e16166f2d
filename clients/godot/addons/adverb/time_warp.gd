# Keytimes and canonical time of one blend: a monotone cubic through the keytimes (docs/math.md).
extends RefCounted

const NEWTON_END = 1e-7

var duration_s = 0.0

var _phases
var _keytimes = [0.0]
var _tangents = []


# `log_lengths`: logarithms of the examples' segment lengths, N × (M − 1).
func _init(phases, log_lengths, looping, weights):
	_phases = phases
	var segments = phases.size() - 1
	for m in range(segments):
		var total = 0.0
		for i in range(weights.size()):
			total += weights[i] * log_lengths[i * segments + m]
		_keytimes.append(_keytimes[m] + exp(total))
	duration_s = _keytimes[segments]
	_tangents = _slopes(looping)


# Logarithms of segment lengths, N × (M − 1), of keytimes N × M.
static func log_lengths_of(keytimes, marks):
	var found = []
	for i in range(keytimes.size() / marks):
		for m in range(marks - 1):
			found.append(log(keytimes[i * marks + m + 1] - keytimes[i * marks + m]))
	return found


# Seconds at a phase, 0 to 1.
func time_at(phase):
	var s = _segment(_phases, phase)
	var width = _phases[s + 1] - _phases[s]
	var u = (phase - _phases[s]) / width
	var v = 1.0 - u
	return (
		v * v * ((1.0 + 2.0 * u) * _keytimes[s] + u * width * _tangents[s])
		+ u * u * ((3.0 - 2.0 * u) * _keytimes[s + 1] - v * width * _tangents[s + 1])
	)


# Phase at seconds: the inverse of `time_at`, by Newton steps that bisection keeps in bounds.
func phase_at(time_s):
	var s = _segment(_keytimes, time_s)
	var y0 = _keytimes[s]
	var y1 = _keytimes[s + 1]
	var width = _phases[s + 1] - _phases[s]
	if time_s <= y0:
		return _phases[s]
	if time_s >= y1:
		return _phases[s + 1]
	var m0 = width * _tangents[s]
	var m1 = width * _tangents[s + 1]
	var low = 0.0
	var high = 1.0
	var u = (time_s - y0) / (y1 - y0)
	for _k in range(60):
		var v = 1.0 - u
		var miss = v * v * ((1.0 + 2.0 * u) * y0 + u * m0) + u * u * ((3.0 - 2.0 * u) * y1 - v * m1) - time_s
		if miss > 0.0:
			high = u
		else:
			low = u
		var rate = 6.0 * u * v * (y1 - y0) + v * (1.0 - 3.0 * u) * m0 + u * (3.0 * u - 2.0) * m1
		var after = u - miss / rate if rate > 0.0 else 0.5 * (low + high)
		if not (after >= low and after <= high):
			after = 0.5 * (low + high)
		var moved = abs(after - u)
		u = after
		if moved < 1e-15 or (moved < NEWTON_END and rate > 0.1 * (y1 - y0)):
			break
	return _phases[s] + u * width


func _segment(knots, at):
	var s = 0
	while s < knots.size() - 2 and at >= knots[s + 1]:
		s += 1
	return s


func _width(m):
	return _phases[m + 1] - _phases[m]


func _secant(m):
	return (_keytimes[m + 1] - _keytimes[m]) / _width(m)


# Slopes of the monotone cubic; those at both ends of a loop are equal.
func _slopes(periodic):
	var last = _phases.size() - 1
	if last == 1:
		return [_secant(0), _secant(0)]
	var found = [0.0]
	for m in range(1, last):
		found.append(_inner_slope(_width(m - 1), _width(m), _secant(m - 1), _secant(m)))
	if periodic:
		found[0] = _inner_slope(_width(last - 1), _width(0), _secant(last - 1), _secant(0))
		found.append(found[0])
		return found
	found[0] = _end_slope(_width(0), _width(1), _secant(0), _secant(1))
	found.append(_end_slope(_width(last - 1), _width(last - 2), _secant(last - 1), _secant(last - 2)))
	return found


func _end_slope(near, far, near_secant, far_secant):
	var slope = ((2.0 * near + far) * near_secant - near * far_secant) / (near + far)
	if slope * near_secant <= 0.0:
		return 0.0
	if near_secant * far_secant <= 0.0 and abs(slope) > 3.0 * abs(near_secant):
		return 3.0 * near_secant
	return slope


func _inner_slope(left, right, left_secant, right_secant):
	if left_secant * right_secant <= 0.0:
		return 0.0
	var a = 2.0 * right + left
	var b = right + 2.0 * left
	return (a + b) / (a / left_secant + b / right_secant)
