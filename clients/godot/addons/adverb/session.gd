# Protocol of a stream (docs/wire.md) without its socket: messages in, messages and events out.
#
# The session survives connections: `resume` takes it over, and where it does not exist any more all channels are opened
# again in their current state.
extends RefCounted

const Channel = preload("channel.gd")
const Clock = preload("clock.gd")
const Lateness = preload("lateness.gd")
const Messages = preload("messages.gd")
const Platform = preload("platform.gd")
const Wire = preload("wire.gd")

const MAX_EVENTS = 1024
const MAX_PINGS = 64
const HALF = 0x80000000
const RETRY_S = 1.0

# Channels by number.
var channels = {}
var clock = Clock.new()
# Messages to send: texts and bytes, in order.
var outbox = []
# Dictionaries with `kind`: opened, version, keytime, end, error, stats, drain, lost, restored; oldest first.
var events = []
var stats = {
	"messages": 0, "records": 0, "dropped": 0, "missing": 0, "stale": 0, "decode_errors": 0, "reconnects": 0,
	"resumes": 0, "last_problem": ""
}
# Whether there is a connection whose session has begun.
var live = false
# Seconds that the server requests before a reconnection (`drain`).
var drain_s = 0.0

var _lateness = Lateness.new()
var _layouts = {}
var _hello = {}
var _session = ""
var _sequence = 0
var _dropped_before = 0
var _pings = {}
var _last_ping = 0
var _barrier = 0
var _confirmed = {}
var _retry_at_s = {}
var _view = {}
var _lost_s = NAN


# --- requests ---


# Open a channel: one character. Options are those of `open` in docs/wire.md except `send`, because a channel without
# messages is held after 0.1 s. Its number; -1: all are in use, or an option is not supported (event `error`).
func open(verb, options):
	if options.has("send"):
		_emit({"kind": "error", "channel": -1, "code": "unsupported", "detail": "the option 'send' is not supported"})
		return -1
	var number = 0
	while channels.has(number):
		number += 1
	if number > 65535:
		return -1
	channels[number] = Channel.new(number, verb, options, _lateness)
	if live:
		_send(channels[number].open_message())
	return number


# Change settings of a channel: adverbs, speed, phase, play, loop, fps, half_life, follow, priority.
func change(number, settings):
	var message = channels[number].change(settings)
	if live:
		_send(message)


# Set the goal: all adverbs in the verb's order, 4 + 4·D bytes. False where their number does not fit.
func aim(number, adverbs):
	if not channels[number].aim(adverbs):
		return false
	if live:
		outbox.append(Wire.encode_adverbs(number, adverbs))
	return true


# Continue with another verb, without a jump. Options: adverbs, method, phase, transition_s.
func switch_to(number, verb, options):
	var message = channels[number].start_switch(verb, options)
	if live:
		_send(message)


# Close a channel.
func close(number):
	if channels.erase(number) and live:
		_send({"op": "close", "channel": number})


# Viewpoint (x, y, z) and byte budget (budget_kbps) of the stream; all are optional.
func view(fields):
	_view = fields.duplicate()
	_view["op"] = "view"
	if live:
		_send(_view)


func ping(now_s):
	_last_ping += 1
	_pings[_last_ping] = now_s
	_pings.erase(_last_ping - MAX_PINGS)
	_send({"op": "ping", "t": _last_ping})


# Repeat requests that the server was not ready for; called from time to time.
func retry(now_s):
	for number in _retry_at_s.keys():
		if now_s >= _retry_at_s[number]:
			_retry_at_s.erase(number)
			if live and channels.has(number):
				_send(channels[number].open_message())


# --- connections ---


# Whether the connection has had its first message.
func greeted():
	return _hello.size() > 0


# The connection has ended.
func disconnected(detail, close_code, now_s):
	if live:
		_emit({"kind": "lost", "detail": detail, "close_code": close_code})
	live = false
	_hello = {}
	_barrier = 0
	_retry_at_s.clear()
	_pings.clear()
	outbox.clear()
	if is_nan(_lost_s) and _session != "":
		_lost_s = now_s


func _connected(hello, now_s):
	_hello = hello
	_lateness.clear()  # another connection may take another route
	if _session == "" or channels.size() == 0:
		_begin(now_s)
		return
	_confirmed.clear()
	_send({"op": "resume", "session": _session, "last_seq": _sequence})
	ping(now_s)
	_barrier = _last_ping  # its pong follows the whole answer to `resume`


# Start a new session and open all channels.
func _begin(now_s):
	_dropped_before = stats["dropped"]
	_session = _hello["session"]
	_sequence = 0
	_layouts.clear()
	_lateness.clear()
	clock.clear()
	live = true
	if _view.size() > 0:
		_send(_view)
	for number in channels:
		_reopen(channels[number])
	_restored(now_s, false)


func _reopen(channel):
	channel.commit_switch()
	channel.buffer.restart()
	_send(channel.open_message())


# Go live after `resume`: apply the current settings of all channels.
func _join(now_s):
	live = true
	if _view.size() > 0:
		_send(_view)
	for number in channels:
		var channel = channels[number]
		if not _confirmed.has(number):
			_reopen(channel)
		elif channel.switching().size() > 0:
			_send(channel.switching())
		elif channel.set_message().size() > 0:
			_send(channel.set_message())
	_restored(now_s, true)


func _restored(now_s, resumed):
	if is_nan(_lost_s):
		return
	stats["reconnects"] += 1
	stats["resumes"] += 1 if resumed else 0
	_emit({"kind": "restored", "resumed": resumed, "outage_s": now_s - _lost_s})
	_lost_s = NAN


# --- messages of the server ---


# Apply a text message; returns the problem, empty where it is valid.
func receive_text(text, now_s):
	var message = Platform.json_value(text)
	var problem = Messages.problem_of(message)
	if problem != "":
		return _malformed(problem)
	if not greeted():
		if message["op"] != "hello":
			return _malformed("the first message is not hello")
		_connected(message, now_s)
		return ""
	return _apply(message, now_s)


func _apply(message, now_s):
	match message["op"]:
		"opened":
			return _opened(message)
		"version":
			_version(message)
		"events":
			for item in message["items"]:
				_emit({"kind": "keytime", "channel": int(item["channel"]), "name": item["name"], "phase": item["phase"]})
		"end":
			if channels.has(int(message["channel"])):
				channels[int(message["channel"])].buffer.end()
			_emit({"kind": "end", "channel": int(message["channel"])})
		"pong":
			_pong(message, now_s)
		"error":
			_rejected(message, now_s)
		"stats":
			_emit({"kind": "stats", "fields": message})
		"drain":
			drain_s = message["reconnect_after_s"]
			_emit({"kind": "drain", "detail": message["detail"]})
	return ""


# Decode a pose message and give its records to the channels; returns the problem, empty where it is valid.
func receive_poses(content, now_s):
	var message = Wire.decode(content, _layouts)
	if message["problem"] != "":
		return _malformed(message["problem"])
	stats["messages"] += 1
	stats["dropped"] = _dropped_before + message["dropped"]
	var step = (message["sequence"] - _sequence) & 0xffffffff
	if step == 0 or step >= HALF:
		stats["stale"] += 1
		return ""
	if step > 1 and _sequence != 0:
		stats["missing"] += step - 1
	_sequence = message["sequence"]
	var due_s = message["time_ns"] * 1e-9
	_lateness.add(now_s, due_s)
	for record in message["records"]:
		stats["records"] += 1
		if channels.has(record["channel"]):
			var channel = channels[record["channel"]]
			channel.buffer.push(due_s, record, _view.has("budget_kbps"))
			channel.got_record()
	return ""


func _malformed(problem):
	stats["decode_errors"] += 1
	stats["last_problem"] = problem
	return problem


func _opened(message):
	var number = int(message["channel"])
	var layout = Wire.layout_of(message["encoding"], message["joints"].size(), int(message["record_bytes"]))
	if layout == null:
		return _malformed("records of %d bytes do not fit the joints of channel %d" % [message["record_bytes"], number])
	_layouts[number] = layout
	if not channels.has(number):
		_send({"op": "close", "channel": number})  # it was closed before the answer arrived
		return ""
	if not channels[number].apply_opened(message):
		return _malformed("'opened' of channel %d is not valid" % number)
	_confirmed[number] = true
	_retry_at_s.erase(number)
	_emit({
		"kind": "opened", "channel": number, "name": message["verb"], "version": int(message["version"]),
		"resumed": message["resumed"]
	})
	return ""


func _version(message):
	var number = int(message["channel"])
	if channels.has(number):
		channels[number].version = int(message["version"])
	_emit({"kind": "version", "channel": number, "version": int(message["version"])})


func _pong(message, now_s):
	var token = int(message["t"])
	if _pings.has(token):
		clock.add(_pings[token], now_s, message["server_time_ns"])
	_pings.erase(token)
	if token == _barrier and _barrier != 0:
		_barrier = 0
		_join(now_s)


func _rejected(message, now_s):
	var code = message["code"]
	var number = int(message["channel"]) if message.get("channel") != null else -1
	if code == "unknown_session" and _barrier != 0:
		_barrier = 0
		_begin(now_s)
		return
	var known = channels.has(number)
	var opened = known and channels[number].is_open() and _layouts.has(number)
	if known and code == "unknown_channel" and not opened:
		return  # a setting after an `open` that was rejected
	if known and code == "channel_in_use":
		_in_use(channels[number])
		return
	if known and code == "not_ready" and not opened:
		_retry_at_s[number] = now_s + RETRY_S
		return
	if known:
		channels[number].error = {"code": code, "detail": message["detail"]}
		channels[number].drop_switch()
	_emit({"kind": "error", "channel": number, "code": code, "detail": message["detail"]})


# An `open` was repeated, of this channel or of a closed one with its number.
func _in_use(channel):
	if not channel.is_open():
		_send({"op": "close", "channel": channel.number})
		_reopen(channel)


func _send(message):
	outbox.append(Platform.json_text(message))


func _emit(event):
	if events.size() >= MAX_EVENTS:
		events.pop_front()
	events.append(event)
