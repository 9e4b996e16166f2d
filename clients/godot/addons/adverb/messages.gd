# Text messages of a server: the fields that a client needs, and their types.
extends RefCounted

const FIELDS = {
	"hello": {"session": "text", "server_time_ns": "number"},
	"opened": {
		"channel": "number", "verb": "text", "version": "number", "skeleton": "object", "adverbs": "list",
		"joints": "list", "encoding": "text", "fps": "number", "looping": "flag", "keytimes": "list",
		"record_bytes": "number", "resumed": "flag"
	},
	"version": {"channel": "number", "version": "number", "record_bytes": "number"},
	"events": {"items": "list"},
	"end": {"channel": "number"},
	"pong": {"t": "number", "server_time_ns": "number"},
	"stats": {
		"seconds": "number", "kbps": "number", "budget_kbps": "number", "records": "number", "left_out": "number",
		"min_fps": "number", "max_fps": "number"
	},
	"error": {"code": "text", "detail": "text"},
	"drain": {"detail": "text", "reconnect_after_s": "number"},
}
const ITEM = {"channel": "number", "name": "text", "phase": "number"}
const SKELETON = {"names": "list", "parents": "list", "offsets": "list"}
const ADVERB = {"name": "text", "min": "number", "max": "number"}


# The problem of a parsed message; empty where it is valid, or its op is unknown.
static func problem_of(message):
	if typeof(message) != TYPE_DICTIONARY or typeof(message.get("op")) != TYPE_STRING:
		return "a text message is not an object with `op`"
	var op = message["op"]
	var problem = _mismatch(message, FIELDS.get(op, {}), op)
	if problem == "" and op == "events":
		problem = _rows(message["items"], ITEM, op)
	if problem == "" and op == "opened":
		problem = _rows(message["adverbs"], ADVERB, op)
		if problem == "":
			problem = _skeleton(message["skeleton"])
	return problem


static func _rows(rows, fields, what):
	for row in rows:
		if typeof(row) != TYPE_DICTIONARY:
			return "'%s' has an item that is not an object" % what
		var problem = _mismatch(row, fields, what)
		if problem != "":
			return problem
	return ""


static func _skeleton(skeleton):
	var problem = _mismatch(skeleton, SKELETON, "skeleton")
	if problem != "":
		return problem
	var count = skeleton["names"].size()
	if count < 1 or skeleton["parents"].size() != count or skeleton["offsets"].size() != count:
		return "the lists of the skeleton have different lengths"
	for joint in range(count):
		var parent = skeleton["parents"][joint]
		if not _is(parent, "number") or parent >= joint or parent < (0 if joint > 0 else -1):
			return "parents of the skeleton do not come before their children"
		var offset = skeleton["offsets"][joint]
		if not _is(offset, "list") or offset.size() != 3:
			return "an offset of the skeleton has not three numbers"
	return ""


static func _mismatch(message, fields, what):
	for name in fields:
		if not message.has(name):
			return "'%s' has no '%s'" % [what, name]
		if not _is(message[name], fields[name]):
			return "'%s' of '%s' is not a %s" % [name, what, fields[name]]
	return ""


static func _is(value, kind):
	match kind:
		"number":
			return typeof(value) == TYPE_FLOAT or typeof(value) == TYPE_INT
		"text":
			return typeof(value) == TYPE_STRING
		"flag":
			return typeof(value) == TYPE_BOOL
		"list":
			return typeof(value) == TYPE_ARRAY
	return typeof(value) == TYPE_DICTIONARY
