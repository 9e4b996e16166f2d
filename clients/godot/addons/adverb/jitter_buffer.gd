# Frames of one channel with irregular arrival times become poses at any display time.
#
# A pose is displayed later than its frame was due: by the interval between two frames and by the lateness of nearly all
# messages. Without new frames, the motion is extrapolated for a short time and then held.
extends RefCounted

const Numbers = preload("numbers.gd")
const Rotations = preload("rotations.gd")
const Wire = preload("wire.gd")

const MAX_FRAMES = 128
const SNAP_S = 0.5
const SLOWER = 0.20
const FASTER = 0.10
const MAX_STEP = 3.5
const GAP_DECAY = 0.9

var interval_s = 1.0 / 60.0
var looping = false
# Bounds of the delay, and the longest extrapolation, s.
var min_delay_s = 0.0
var max_delay_s = 0.25
var extrapolate_s = 0.1
var duplicates = 0

var _lateness
var _times = []
var _records = []
var _gap_s = 0.0
var _lag_s = NAN
var _sampled_s = -INF
var _restart_pending = false
var _ending = false
var _end_phase = NAN


# `lateness` is that of the stream's messages, which its channels share.
func _init(lateness):
	_lateness = lateness


# The newest frame; null before the first.
func last():
	return _records[_records.size() - 1] if _records.size() > 0 else null


# Add a frame. `irregular`: a byte budget leaves frames out, so the interval is that of the frames that arrive.
func push(due_s, record, irregular):
	if _restart_pending:
		_forget()
	var at = _after(due_s)
	if at > 0 and _times[at - 1] == due_s:
		duplicates += 1
		return
	var gap_s = due_s - _times[at - 1] if at > 0 and at == _times.size() else 0.0
	_gap_s = Numbers.most(gap_s, GAP_DECAY * _gap_s) if irregular else 0.0
	_times.insert(at, due_s)
	_records.insert(at, _marked(record))
	if _times.size() > MAX_FRAMES:
		_times.pop_front()
		_records.pop_front()


# The motion ends with the next frame.
func end():
	_ending = true


# Restart at the next frame, which may be on another clock; until then the old frames are displayed.
func restart():
	_restart_pending = true


# Target of the delay: interval plus lateness, within the bounds.
func delay_s():
	var measured = _lateness.measured()
	var late_s = measured[1] if measured != null else 0.0
	return Numbers.least(Numbers.most(_spacing_s() + late_s, min_delay_s), max_delay_s)


# The pose to display at a time on the clock of arrivals; null before the first frame. It has server_time_s, phase,
# time_s, duration_s, error, version, clamped, in_transition, ended, encoding, values, delay_s, extrapolated_s, held,
# support (-1: not requested).
func sample(now_s):
	if _times.size() == 0:
		return null
	var head = _playhead(now_s)
	return _between(head[0], head[1])


func _spacing_s():
	return Numbers.most(interval_s, _gap_s)


# Number of frames that were due at a time or before.
func _after(due_s):
	var at = _times.size()
	while at > 0 and _times[at - 1] > due_s:
		at -= 1
	return at


# The record, with the flag `last` also where the motion rests at its end.
func _marked(record):
	var is_last = record["flags"] & Wire.LAST != 0
	if _ending or is_last:
		_ending = false
		_end_phase = record["phase"]
	if record["phase"] != _end_phase:
		_end_phase = NAN
	elif not is_last:
		record = record.duplicate()
		record["flags"] = record["flags"] | Wire.LAST
	return record


func _forget():
	_gap_s = 0.0
	_times.clear()
	_records.clear()
	_lag_s = NAN
	_sampled_s = -INF
	_restart_pending = false
	_end_phase = NAN


# [instant to display on the server's clock, its delay].
func _playhead(now_s):
	var measured = _lateness.measured()
	if measured == null or _restart_pending:
		var lag_s = now_s - _times[0] if is_nan(_lag_s) else _lag_s
		return [now_s - lag_s, delay_s()]  # the clocks are not compared yet
	var target_s = measured[0] + delay_s()
	if is_nan(_lag_s) or abs(target_s - _lag_s) > SNAP_S:
		_lag_s = target_s
	elif now_s > _sampled_s:
		var passed_s = now_s - _sampled_s
		_lag_s += Numbers.least(Numbers.most(target_s - _lag_s, -FASTER * passed_s), SLOWER * passed_s)
	_sampled_s = Numbers.most(now_s, _sampled_s)
	return [now_s - _lag_s, _lag_s - measured[0]]


# The pose at an instant: interpolated between two frames, or extrapolated past the last one.
func _between(shown_s, shown_delay_s):
	var at = _after(shown_s)
	if at == 0:
		return _blended(_records[0], _records[0], 0.0, [_times[0], shown_delay_s, 0.0])
	if at < _times.size():
		var part = (shown_s - _times[at - 1]) / (_times[at] - _times[at - 1])
		return _blended(_records[at - 1], _records[at], part, [shown_s, shown_delay_s, 0.0])
	var newest = _records[at - 1]
	var extrapolated_s = shown_s - _times[at - 1]
	var clock = [shown_s, shown_delay_s, extrapolated_s]
	var step_s = _times[at - 1] - _times[at - 2] if at > 1 else INF
	if step_s > MAX_STEP * _spacing_s() or newest["flags"] & Wire.LAST != 0:
		return _blended(newest, newest, 1.0, clock)
	return _blended(_records[at - 2], newest, 1.0 + Numbers.least(extrapolated_s, extrapolate_s) / step_s, clock)


# Interpolate two frames; a share above 1 extrapolates past the second. `clock`: shown time, delay, extrapolation.
func _blended(a, b, share, clock):
	var near = a if share < 0.5 else b
	var error = near["error"]
	if not (is_nan(a["error"]) or is_nan(b["error"]) or share > 1.0):
		error = _lerp(a["error"], b["error"], share)
	var moment = _moment(a, b, share)
	return {
		"server_time_s": clock[0],
		"phase": moment[0],
		"time_s": moment[1],
		"duration_s": _lerp(a["duration_s"], b["duration_s"], Numbers.least(share, 1.0)),
		"error": error,
		"version": near["version"],
		"clamped": near["flags"] & Wire.CLAMPED != 0,
		"in_transition": near["flags"] & Wire.IN_TRANSITION != 0,
		"ended": near["flags"] & Wire.LAST != 0,
		"encoding": near["encoding"],
		"values": _values(a, b, near, share),
		"delay_s": clock[1],
		"extrapolated_s": clock[2],
		"held": clock[2] > extrapolate_s,
		"support": Wire.support_of(near["flags"]),
	}


func _values(a, b, near, share):
	var from = a["values"]
	var to = b["values"]
	var weights = a["encoding"] == Wire.WEIGHTS
	if from.size() != to.size() or weights != (b["encoding"] == Wire.WEIGHTS):
		return near["values"]
	var out = []
	for k in range(from.size() if weights else 3):
		out.append(_lerp(from[k], to[k], share))
	if not weights:
		for k in range(3, from.size(), 4):
			Rotations.append_slerp(out, from, to, k, share)
	return out


# [phase, seconds], across the end of a loop where that is shorter.
func _moment(a, b, share):
	if not looping:
		var longest_s = Numbers.most(a["duration_s"], b["duration_s"])
		return [
			Numbers.bounded(_lerp(a["phase"], b["phase"], share), 0.0, 1.0),
			Numbers.bounded(_lerp(a["time_s"], b["time_s"], share), 0.0, longest_s)
		]
	var wrap = round(a["phase"] - b["phase"])  # 1 across the end forwards, -1 backwards
	var whole_s = b["duration_s"]
	var time_s = _lerp(a["time_s"], b["time_s"] + wrap * whole_s, share)
	return [
		fposmod(_lerp(a["phase"], b["phase"] + wrap, share), 1.0), fposmod(time_s, whole_s) if whole_s > 0.0 else 0.0
	]


func _lerp(a, b, share):
	return a + share * (b - a)
