# One character of a stream. Settings made without a connection are sent after the reconnection.
extends RefCounted

const JitterBuffer = preload("jitter_buffer.gd")
const Numbers = preload("numbers.gd")
const Rotations = preload("rotations.gd")
const Wire = preload("wire.gd")

const SETTINGS = ["adverbs", "speed", "play", "loop", "fps", "half_life", "follow", "priority"]

var number = 0
# The server's latest description of the channel (`opened` of docs/wire.md); empty before it is open.
var info = {}
var version = 0
# {code, detail}: why the channel could not be opened or switched; empty where it could.
var error = {}
var buffer

# Fields of `open` except adverbs and phase.
var _desired = {}
var _adverbs = {}
var _pending_phase = NAN
# Fields of a `switch` without an answer so far.
var _switch = {}
var _parents = []
var _offsets = []


func _init(new_number, verb, options, lateness):
	number = new_number
	buffer = JitterBuffer.new(lateness)
	buffer.interval_s = 1.0 / options.get("fps", 60)
	_desired = options.duplicate()
	_desired["verb"] = verb
	_adverbs = options.get("adverbs", {}).duplicate()
	_desired.erase("adverbs")
	_pending_phase = float(options.get("phase", NAN))
	_desired.erase("phase")


func is_open():
	return info.size() > 0


# Name of the verb: as opened, or as requested.
func verb():
	return info["verb"] if is_open() else _desired["verb"]


# Joint positions of a pose (3 per joint, m) and global rotations (4 per joint): {positions, rotations}.
func solve(values):
	return Rotations.solve(_parents, _offsets, values)


# Keep settings for a reconnection; returns the message `set`.
func change(settings):
	for name in settings:
		if name == "adverbs":
			for adverb in settings[name]:
				_adverbs[adverb] = settings[name][adverb]
		elif name == "phase":
			_pending_phase = float(settings[name])
		else:
			_desired[name] = settings[name]
	if settings.has("fps"):
		buffer.interval_s = 1.0 / settings["fps"]
	var message = settings.duplicate()
	message["op"] = "set"
	message["channel"] = number
	return message


# Keep a goal, all adverbs in the verb's order; false where the number of adverbs does not fit, or is not known yet.
func aim(adverbs):
	if not is_open() or _switch.size() > 0 or adverbs.size() != info["adverbs"].size():
		return false
	for k in range(adverbs.size()):
		_adverbs[info["adverbs"][k]["name"]] = adverbs[k]
	return true


# Fields of `switch`, which are kept until the answer.
func start_switch(verb_name, options):
	_switch = options.duplicate()
	_switch["op"] = "switch"
	_switch["channel"] = number
	_switch["verb"] = verb_name
	return _switch


func switching():
	return _switch


func drop_switch():
	_switch = {}


# Apply the message `opened`; false where its layout does not fit.
func apply_opened(message):
	var layout = Wire.layout_of(message["encoding"], message["joints"].size(), int(message["record_bytes"]))
	if layout == null or not message["fps"] > 0.0:
		return false
	var switched = _switch.size() > 0 and message["verb"] == _switch["verb"]
	if switched:
		commit_switch()
	var restarted = not is_open() or not (switched or message["resumed"])
	info = message
	version = int(message["version"])
	error = {}
	_parents = message["skeleton"]["parents"]
	_offsets = []
	for offset in message["skeleton"]["offsets"]:
		for k in range(3):
			_offsets.append(offset[k])
	buffer.interval_s = 1.0 / message["fps"]
	buffer.looping = message["looping"]
	if restarted:
		buffer.restart()
	return true


# Make the verb, adverbs and method of the switch those of the channel.
func commit_switch():
	if _switch.size() == 0:
		return
	_desired["verb"] = _switch["verb"]
	_desired.erase("method")
	if _switch.has("method"):
		_desired["method"] = _switch["method"]
	_adverbs = _switch.get("adverbs", {}).duplicate()
	_switch = {}


func got_record():
	_pending_phase = NAN


# The message that opens the channel with its current settings at its last known phase.
func open_message():
	var message = _desired.duplicate()
	message["op"] = "open"
	message["channel"] = number
	if _adverbs.size() > 0 and (not is_open() or _adverbs.size() == info["adverbs"].size()):
		message["adverbs"] = _adverbs.duplicate()
	var newest = buffer.last()
	if not is_nan(_pending_phase):
		message["phase"] = _pending_phase
	elif newest != null:
		message["phase"] = Numbers.bounded(newest["phase"], 0.0, 1.0)
	return message


# The message that applies all settings to a resumed channel; empty where there are none.
func set_message():
	var message = {}
	for name in SETTINGS:
		if _desired.has(name):
			message[name] = _desired[name]
	if _adverbs.size() > 0:
		message["adverbs"] = _adverbs.duplicate()
	if not is_nan(_pending_phase):
		message["phase"] = _pending_phase
	if message.size() > 0:
		message["op"] = "set"
		message["channel"] = number
	return message
