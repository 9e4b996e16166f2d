# A stream of characters: connects, reconnects and resumes. Call `poll` once per frame.
#
#     var stream = Stream.new("http://127.0.0.1:8000", "")
#     var number = stream.session.open("reach", {"encoding": "q48"})
#     func _process(_delta):
#         stream.poll()
#         var pose = stream.sample(number)
extends RefCounted

const Http = preload("http.gd")
const Numbers = preload("numbers.gd")
const Platform = preload("platform.gd")
const Session = preload("session.gd")
const Socket = preload("socket.gd")

const SUBPROTOCOL = "adverb.v1"
const REVOKED = 4401
const RESUMED_ELSEWHERE = 4009
const STABLE_AFTER_S = 5.0
const MAX_DRAIN_S = 60.0

# Longest time for a connection to be made, and without any message, s.
var hello_timeout_s = 10.0
var silence_s = 10.0
# First and longest delay between attempts, s; half of each is random.
var first_delay_s = 0.1
var max_delay_s = 5.0
# How long the first connection and a reconnection are tried, s.
var connect_timeout_s = 10.0
var reconnect_timeout_s = 120.0

var session = Session.new()
# {code, detail}: why the stream has ended; empty while it has not. Codes: unauthenticated, missing_scope, offline,
# closed.
var ended = {}
# Why there is no connection at the moment.
var failure = "not connected yet"

var _address
var _key
var _socket = null
var _check = null
var _began_s = 0.0
var _received_s = 0.0
var _ping_at_s = 0.0
var _pings = 0
var _again_at_s = 0.0
var _disconnected_s = NAN
var _connected_once = false
var _failures = 0
# Whether the stream has ended because of its key.
var _refused = false


# `address`: http:// or https:// with host and port, and maybe a path. `key`: empty where the server requires none.
func _init(address, key):
	_address = address.rstrip("/")
	_key = key


# The pose to display now, see JitterBuffer.sample; null before the first frame.
func sample(number):
	return session.channels[number].buffer.sample(Platform.now_s()) if session.channels.has(number) else null


# The events since the last call, oldest first.
func take_events():
	var found = session.events
	session.events = []
	return found


# Set the key of the next connections. A stream that has ended because its key was refused connects again, and
# continues with its channels in their current state.
func set_key(key):
	_key = key
	_check = null
	if not _refused:
		return
	_refused = false
	ended = {}
	_failures = 0
	_again_at_s = 0.0
	_disconnected_s = NAN


# Close the stream; the server closes its channels.
func close():
	_refused = false
	_end("closed", "the stream was closed by this client")


# Send and receive; call it once per frame.
func poll():
	if ended.size() > 0:
		return
	var now_s = Platform.now_s()
	if is_nan(_disconnected_s):
		_disconnected_s = now_s
	if _check != null:
		_poll_check()
	elif _socket != null:
		_poll_socket(now_s)
	elif now_s >= _again_at_s:
		_start(now_s)


func _start(now_s):
	var protocols = [SUBPROTOCOL]
	if _key != "":
		protocols.append("adverb.bearer." + _key)
	_began_s = now_s
	_received_s = now_s
	_pings = 0
	_socket = Socket.new()
	if not _socket.open("ws" + _address.substr(4, _address.length()) + "/v1/stream", protocols):
		_lost("the address %s is not valid" % _address, now_s)


func _poll_socket(now_s):
	_socket.poll()
	for message in _socket.take():
		_received_s = now_s
		var problem = ""
		if typeof(message) == TYPE_STRING:
			problem = session.receive_text(message, now_s)
		else:
			problem = session.receive_poses(message, now_s)
		if problem != "" and not session.greeted():
			_lost(problem, now_s)
			return
	if _socket.closed():
		_lost(_socket.reason(), now_s)
	elif now_s - _received_s > (silence_s if session.greeted() else hello_timeout_s):
		_lost("no message for %.1f s" % (now_s - _received_s), now_s)
	else:
		_write(now_s)


func _write(now_s):
	if session.greeted() and now_s >= _ping_at_s:
		_pings += 1
		_ping_at_s = now_s + (0.1 if _pings < 5 else 1.0)
		session.ping(now_s)
		session.retry(now_s)
	for message in session.outbox:
		_socket.send(message)
	session.outbox.clear()


# The connection has ended, or was not made.
func _lost(detail, now_s):
	var code = _socket.close_code()
	var greeted = session.greeted()
	_socket.drop()
	_socket = null
	failure = detail
	session.disconnected(detail, code, now_s)
	if greeted:
		_connected_once = true
		_disconnected_s = now_s
		if now_s - _began_s > STABLE_AFTER_S:
			_failures = 0
	if code == RESUMED_ELSEWHERE:
		_end("closed", "another connection has resumed this session")
		return
	var full_s = Numbers.least(max_delay_s, first_delay_s * pow(2.0, Numbers.least(_failures, 30)))
	_failures += 1
	_again_at_s = now_s + Numbers.most(Numbers.least(session.drain_s, MAX_DRAIN_S), full_s * (0.5 + 0.5 * randf()))
	session.drain_s = 0.0
	if not greeted or code == REVOKED:
		_check = Http.new()  # handshakes do not state why they were refused
		_check.timeout_s = hello_timeout_s
		_check.start(_address, "GET", "/v1/access", _key, "")
	else:
		_give_up(now_s)


# Read why a connection was refused, by REST.
func _poll_check():
	if not _check.poll():
		return
	var status = _check.status
	var body = Platform.json_value(_check.text()) if status > 0 else null
	_check = null
	var fields = body if typeof(body) == TYPE_DICTIONARY else {}
	_refused = status == 401 or status == 403
	if _refused:
		_end(fields.get("code", "unauthenticated"), fields.get("detail", "the key was refused"))
	elif status == 200 and _key != "" and not _may_pose(fields.get("scopes")):
		_refused = true
		_end("missing_scope", "the key does not have the scope pose")
	else:
		_give_up(Platform.now_s())


func _may_pose(scopes):
	return typeof(scopes) != TYPE_ARRAY or scopes.size() == 0 or "pose" in scopes or "admin" in scopes


func _give_up(now_s):
	var patience_s = reconnect_timeout_s if _connected_once else connect_timeout_s
	if now_s - _disconnected_s > patience_s:
		_end("offline", "no connection to %s within %.1f s: %s" % [_address, patience_s, failure])


func _end(code, detail):
	if ended.size() > 0:
		return
	ended = {"code": code, "detail": detail}
	if _socket != null:
		_socket.close()
		_socket = null
	session.disconnected(detail, 0, Platform.now_s())
	session.events.append({"kind": "closed", "code": code, "detail": detail})
