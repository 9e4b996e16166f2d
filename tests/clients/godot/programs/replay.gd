# A recorded stream: joint positions of all records. Texts and poses go through the session of the addon.
extends "program.gd"

const Evaluator = preload("res://addons/adverb/evaluator.gd")
const Session = preload("res://addons/adverb/session.gd")
const Wire = preload("res://addons/adverb/wire.gd")

var _evaluators = {}


func replay(recording, expected, root):
	for row in read_json(expected)["artifacts"]:
		_evaluators["%s %d" % [row["verb"], row["version"]]] = Evaluator.new(read_bytes(root + "/" + row["file"]))
	var session = Session.new()
	for number in range(1, 7):
		session.channels[number] = Session.Channel.new(number, "", {}, session._lateness)
	var stream = StreamPeerBuffer.new()
	stream.data_array = read_bytes(recording)
	var found = []
	while stream.get_position() < stream.get_size():
		var kind = stream.get_u32()
		var content = stream.get_data(stream.get_u32())[1]
		if kind == 0:
			assert(session.receive_text(content.get_string_from_utf8(), 1.0) == "")
		else:
			assert(session.receive_poses(content, 1.0) == "")
			found.append(poses(session, content))
	return {"messages": found, "stats": session.stats, "events": session.events}


func poses(session, content):
	var message = Wire.decode(content, session._layouts)
	var rows = []
	for record in message["records"]:
		rows.append({
			"channel": record["channel"], "version": record["version"],
			"positions": positions(session.channels[record["channel"]], record)
		})
	return {"sequence": message["sequence"], "records": rows}


func positions(channel, record):
	if record["encoding"] != Wire.WEIGHTS:
		return channel.solve(record["values"])["positions"]
	var evaluator = _evaluators["%s %d" % [channel.verb(), record["version"]]]
	return evaluator.solve(evaluator.pose_of(record["values"], record["phase"])["values"])["positions"]
