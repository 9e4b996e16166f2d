# Lateness of messages relative to the earliest ones: a quantile of the transits minus the smallest one.
extends RefCounted

const Numbers = preload("numbers.gd")

const WINDOW = 512
const QUANTILE = 0.98

var _transits = []
var _next = 0
var _measured = null


# Add a message: its arrival on this machine's clock and its due time on the server's, s.
func add(arrived_s, due_s):
	if _transits.size() < WINDOW:
		_transits.append(arrived_s - due_s)
	else:
		_transits[_next % WINDOW] = arrived_s - due_s
	_next += 1
	_measured = null


# Discard all samples; another server has another clock.
func clear():
	_transits.clear()
	_next = 0
	_measured = null


# [smallest transit, lateness], s; null before the first message.
func measured():
	if _measured == null and _transits.size() > 0:
		var transits = _transits.duplicate()
		transits.sort()
		var at = int(Numbers.least(transits.size() - 1, ceil(QUANTILE * transits.size())))
		_measured = [transits[0], transits[at] - transits[0]]
	return _measured
