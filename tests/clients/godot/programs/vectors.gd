# Test vectors of the wire and of evaluators: prints what the addon makes of them.
extends "program.gd"

const Clock = preload("res://addons/adverb/clock.gd")
const Evaluator = preload("res://addons/adverb/evaluator.gd")
const Http = preload("res://addons/adverb/http.gd")
const JitterBuffer = preload("res://addons/adverb/jitter_buffer.gd")
const Lateness = preload("res://addons/adverb/lateness.gd")
const Messages = preload("res://addons/adverb/messages.gd")
const Session = preload("res://addons/adverb/session.gd")
const Wire = preload("res://addons/adverb/wire.gd")


func wire(path):
	var vectors = read_json(path)
	return {
		"poses": decoded(vectors["pose_messages"]),
		"malformed": problems(vectors["malformed_pose_messages"]),
		"layouts": layouts(vectors["layouts"]),
		"one": one(vectors["adverb_messages"]),
		"many": many(vectors["bulk_adverb_messages"]),
		"q48": words(vectors["q48"]["decode"]),
		"q32": words(vectors["q32"]["decode"]),
		"clocks": clocks(vectors["clocks"]),
		"lateness": lateness(vectors["jitter"]),
		"texts": texts(vectors["server_messages"]),
		"malformed_texts": texts(vectors["malformed_server_messages"]),
	}


func layouts_of(vector):
	var found = {}
	for number in vector["layouts"]:
		var row = vector["layouts"][number]
		found[int(number)] = Wire.layout_of(row["encoding"], int(row["joints"]), int(row["record_bytes"]))
	return found


func decoded(vectors):
	var found = []
	for vector in vectors:
		var message = Wire.decode(bytes_of(vector["hex"]), layouts_of(vector))
		message["time_ns"] = str(message["time_ns"])
		found.append(message)
	return found


func problems(vectors):
	var found = []
	for vector in vectors:
		found.append(Wire.decode(bytes_of(vector["hex"]), layouts_of(vector))["problem"])
	return found


func layouts(vectors):
	var found = []
	for row in vectors:
		found.append(Wire.layout_of(row["encoding"], int(row["joints"]), int(row["record_bytes"])) != null)
	return found


# Problems of text messages.
func texts(vectors):
	var found = []
	for vector in vectors:
		found.append(Messages.problem_of(Platform.json_value(vector["text"])))
	return found


# Rotations of words, each decoded as a record of one joint.
func words(vectors):
	var found = []
	for row in vectors:
		var values = []
		if row.has("word"):
			Wire._append_q32(values, int(row["word"]))
		else:
			var parts = row["words"]
			Wire._append_q48(values, int(parts[0]), int(parts[1]), int(parts[2]))
		found.append(values)
	return found


func one(vectors):
	var found = []
	for row in vectors:
		found.append(Wire.encode_adverbs(int(row["channel"]), row["adverbs"]).hex_encode())
	return found


func many(vectors):
	var found = []
	for row in vectors:
		found.append(Wire.encode_bulk_adverbs(row["channels"], row["adverbs"]).hex_encode())
	return found


func clocks(vectors):
	var found = []
	for vector in vectors:
		var clock = Clock.new()
		for ping in vector["pings"]:
			clock.add(ping["sent_s"], ping["arrived_s"], int(ping["server_time_ns"]))
		found.append([clock.offset_s(), clock.round_trip_s()])
	return found


func lateness(vectors):
	var found = []
	for vector in vectors:
		var measure = Lateness.new()
		for pair in vector["arrived_due_s"]:
			measure.add(pair[0], pair[1])
		found.append(measure.measured())
	return found


# Poses that the jitter buffer displays of a plan.
func jitter(path):
	var plan = read_json(path)
	var measure = Lateness.new()
	var buffer = JitterBuffer.new(measure)
	buffer.interval_s = plan["interval_s"]
	buffer.looping = plan["looping"]
	var found = []
	for step in plan["steps"]:
		match step["do"]:
			"push":
				measure.add(step["arrived"], step["due"])
				buffer.push(step["due"], record_of(step, plan["weights"]), step["irregular"])
			"sample":
				found.append(buffer.sample(step["now"]))
			"end":
				buffer.end()
			"restart":
				buffer.restart()
	return found


func record_of(step, weights):
	return {
		"encoding": Wire.WEIGHTS if weights else Wire.F32, "flags": int(step["flags"]), "version": int(step["version"]),
		"phase": step["phase"], "time_s": step["time"], "duration_s": step["duration"], "values": step["values"],
		"error": NAN if step["error"] == null else step["error"]
	}


# Messages that a session sends after each error of a server that restarts, and its events.
func session_errors(opened):
	var session = Session.new()
	session.receive_text('{"op": "hello", "session": "a", "server_time_ns": 1}', 0.0)
	session.open("reach", {})
	var found = {"open": ops(session)}
	for code in ["channel_in_use", "unknown_channel", "not_ready"]:
		session.receive_text('{"op": "error", "channel": 0, "code": "%s", "detail": "d"}' % code, 1.0)
		found[code] = ops(session)
	session.retry(1.5)
	found["early"] = ops(session)
	session.retry(2.5)
	found["retry"] = ops(session)
	session.receive_text('{"op": "error", "channel": 0, "code": "not_ready", "detail": "d"}', 3.0)
	session.receive_text(opened, 3.0)
	session.retry(9.0)
	session.receive_text('{"op": "error", "channel": 0, "code": "channel_in_use", "detail": "d"}', 9.0)
	found["opened"] = ops(session)
	found["events"] = []
	for event in session.events:
		found["events"].append(event["kind"])
	return found


func ops(session):
	var found = []
	for text in session.outbox:
		found.append(Platform.json_value(text)["op"])
	session.outbox.clear()
	return found


# A pose and a verb file by REST.
func rest(address, key, verb):
	var posed = request(address, "POST", "/v1/verbs/%s/pose" % verb, key, '{"adverbs": {"x": 0.5, "y": 0.2}, "phase": 0.5}')
	var file = request(address, "GET", "/v1/verbs/%s/artifact" % verb, key, "")
	return {
		"pose": {"status": posed.status, "fields": Platform.json_value(posed.text()), "problem": posed.problem},
		"file": {"status": file.status, "problem": Evaluator.new(file.body).problem, "size": file.body.size()},
	}


func request(address, method, path, key, content):
	var http = Http.new()
	http.start(address, method, path, key, content)
	while not http.poll():
		OS.delay_msec(2)
	return http


func evaluate(path, root):
	var found = []
	for verb in read_json(path)["verbs"]:
		var evaluator = Evaluator.new(read_bytes(root + "/" + verb["file"]))
		var row = {"problem": evaluator.problem, "weights": [], "adverbs": []}
		for case in verb["weights"]:
			var pose = evaluator.pose_of(case["weights"], case["phase"])
			row["weights"].append(at(evaluator, pose, case["weights"], false))
		for case in verb["adverbs"]:
			var adverbs = []
			for adverb in evaluator.facts["adverbs"]:
				adverbs.append(case["adverbs"][adverb["name"]])
			var blend = evaluator.weights_at(adverbs, case["method"])
			var pose = {}
			if case.has("time"):
				pose = evaluator.pose_at_time(blend["weights"], case["time"])
			else:
				pose = evaluator.pose_of(blend["weights"], case["phase"])
			row["adverbs"].append(at(evaluator, pose, blend["weights"], blend["clamped"]))
		found.append(row)
	return found


func at(evaluator, pose, weights, clamped):
	return {
		"at": [pose["phase"], pose["time_s"], pose["duration_s"]],
		"weights": weights,
		"clamped": clamped,
		"positions": evaluator.solve(pose["values"])["positions"],
	}


# Problems of damaged files.
func damage(path):
	var content = read_bytes(path)
	var found = []
	for at in [0, 9, content.size() - 1, 40, 2000]:
		var damaged = read_bytes(path)
		damaged[at] = damaged[at] ^ 0x41
		found.append(Evaluator.new(damaged).problem)
	for size in [3, 100, content.size() - 8]:
		found.append(Evaluator.new(content.subarray(0, size - 1)).problem)
	found.append(Evaluator.new(content).problem)
	return found


# Microseconds per pose of weights.
func bench(path, rounds):
	var evaluator = Evaluator.new(read_bytes(path))
	var weights = []
	for _k in range(evaluator.facts["examples"].size()):
		weights.append(1.0 / evaluator.facts["examples"].size())
	var start = OS.get_ticks_usec()
	for k in range(rounds):
		evaluator.solve(evaluator.pose_of(weights, float(k) / rounds)["values"])
	return (OS.get_ticks_usec() - start) / float(rounds)
