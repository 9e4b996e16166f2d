# Drives one channel of a stream: commands in, events out, as lines of JSON on a TCP connection.
extends SceneTree

const Platform = preload("res://addons/adverb/platform.gd")
const Stream = preload("res://addons/adverb/stream.gd")

const POSE_S = 0.02

var _peer = StreamPeerTCP.new()
var _input = ""
var _stream
var _channel = 0
var _shown = 0
var _pose_at_s = 0.0
var _stays = false


func _initialize():
	var settings = JSON.parse(OS.get_environment("ADVERB_PROGRAM")).result
	assert(_peer.connect_to_host("127.0.0.1", int(settings["port"])) == OK)
	while _peer.get_status() == StreamPeerTCP.STATUS_CONNECTING:
		OS.delay_msec(5)
	_stream = Stream.new(settings["server"], settings["key"])
	_stream.connect_timeout_s = settings["timeout"]
	_stream.silence_s = settings["silence"]
	_stream.hello_timeout_s = settings["patience"]
	_stays = settings["stays"]
	var options = settings["options"]
	if options.has("fps"):
		options["fps"] = int(options["fps"])
	_channel = _stream.session.open(settings["verb"], options)


func _idle(_delta):
	_stream.poll()
	for event in _stream.take_events():
		_print(event["kind"], event)
	_read_commands()
	if _stream.ended.size() > 0 and not _stays:
		_print("ended", _stream.ended)
		quit()
		return true
	var now_s = Platform.now_s()
	if now_s >= _pose_at_s:
		_pose_at_s = now_s + POSE_S
		_show()
	OS.delay_msec(2)
	return false


func _show():
	var pose = _stream.sample(_channel)
	if pose == null:
		return
	_shown += 1
	var channel = _stream.session.channels[_channel]
	pose["number"] = _shown
	pose["verb"] = channel.verb()
	if pose["encoding"] != 2:
		pose["positions"] = channel.solve(pose["values"])["positions"]
	if is_nan(pose["error"]):
		pose["error"] = null
	_print("pose", pose)


func _read_commands():
	var available = _peer.get_available_bytes()
	if available > 0:
		_input += _peer.get_utf8_string(available)
	while "\n" in _input:
		var line = _input.split("\n", true, 1)[0]
		_input = _input.substr(line.length() + 1, _input.length())
		_run(JSON.parse(line).result)


func _run(fields):
	var command = fields["command"]
	fields.erase("command")
	match command:
		"set":
			if fields.has("fps"):
				fields["fps"] = int(fields["fps"])
			_stream.session.change(_channel, fields)
		"aim":
			_print("aimed", {"sent": _stream.session.aim(_channel, fields["adverbs"])})
		"switch":
			_stream.session.switch_to(_channel, fields["verb"], {})
		"view":
			_stream.session.view({"budget_kbps": int(fields["budget_kbps"])})
		"key":
			_stream.set_key(fields["key"])
		"stats":
			var stats = _stream.session.stats.duplicate()
			stats["round_trip_s"] = _stream.session.clock.round_trip_s()
			_print("counters", stats)
		"close":
			_stream.close()


func _print(name, fields):
	fields["event"] = name
	_peer.put_data((Platform.json_text(fields) + "\n").to_utf8())
