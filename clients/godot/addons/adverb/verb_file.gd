# Reader of verb files (docs/artifact.md): a safetensors container with the facts and arrays of a verb.
extends RefCounted

const Platform = preload("platform.gd")

const FORMAT = 2
const MAX_HEADER_BYTES = 16777216
const SIZES = {"F32": 4, "F64": 8, "I64": 8}
const NUMPY = {"F32": "<f4", "F64": "<f8", "I64": "<i8"}
const FACTS = [
	"name", "looping", "joints", "adverbs", "ranges", "examples", "keytime_names", "rotation_mode", "root_motion",
	"domain", "bases"
]

# Why the file cannot be read; empty where it can.
var problem = ""
# JSON value: name, adverbs, joints, …
var facts = {}
# {dtype, shape, begin, end} by name; offsets from the start of the file.
var entries = {}

var _content
var _text = ""


# Read a file and compare its checksum.
func _init(content):
	_content = content
	problem = _read()
	if problem == "":
		problem = _verify()


# Numbers of an array in C order; empty, with a problem, where it does not exist or has another shape. −1 stands for any
# length. F32 is an array of floats, the others are arrays of numbers.
func numbers(name, shape):
	if not entries.has(name) or not _fits(entries[name]["shape"], shape):
		problem = "the file does not describe a verb: array '%s'" % name
		return []
	var entry = entries[name]
	match entry["dtype"]:
		"F32":
			return Platform.float32s(_content, entry["begin"], entry["end"])
		"F64":
			return Platform.float64s(_content, entry["begin"], entry["end"])
	var stream = StreamPeerBuffer.new()
	stream.data_array = Platform.slice(_content, entry["begin"], entry["end"])
	var found = []
	for _k in range((entry["end"] - entry["begin"]) / 8):
		found.append(stream.get_64())
	return found


func has(name):
	return entries.has(name)


func _fits(found, shape):
	if found.size() != shape.size():
		return false
	for k in range(shape.size()):
		if shape[k] != -1 and int(found[k]) != int(shape[k]):
			return false
	return true


func _read():
	var length = _content.size()
	if length < 16:
		return "not a verb file: it is too short"
	var stream = StreamPeerBuffer.new()
	stream.data_array = Platform.slice(_content, 0, 8)
	var header_bytes = stream.get_64()
	if header_bytes < 2 or header_bytes > MAX_HEADER_BYTES or header_bytes > length - 8:
		return "not a verb file: it is not a safetensors file"
	var header = Platform.json_value(Platform.slice(_content, 8, 8 + header_bytes).get_string_from_utf8())
	if typeof(header) != TYPE_DICTIONARY or typeof(header.get("__metadata__")) != TYPE_DICTIONARY:
		return "not a verb file: its header is invalid"
	_text = header["__metadata__"].get("adverb", "")
	var parsed = Platform.json_value(_text)
	if typeof(parsed) != TYPE_DICTIONARY or not parsed.has("format"):
		return "not a verb file: its header is invalid"
	facts = parsed
	if facts["format"] > FORMAT:
		return "the file has format %d; this addon reads up to %d: upgrade it" % [facts["format"], FORMAT]
	for name in FACTS:
		if not facts.has(name):
			return "the file does not describe a verb: %s" % name
	header.erase("__metadata__")
	for name in header:
		var found = _add_entry(name, header[name], 8 + header_bytes)
		if found != "":
			return found
	return ""


func _add_entry(name, entry, start):
	if not SIZES.has(entry.get("dtype")) or entry["data_offsets"].size() != 2:
		return "array '%s' has an unknown type" % name
	var count = 1
	for side in entry["shape"]:
		count *= int(side)
	var begin = start + int(entry["data_offsets"][0])
	var end = start + int(entry["data_offsets"][1])
	if begin < start or end - begin != count * SIZES[entry["dtype"]] or end > _content.size():
		return "array '%s' does not fit into the file" % name
	entries[name] = {"dtype": entry["dtype"], "shape": entry["shape"], "begin": begin, "end": end}
	return ""


# SHA-256 over the facts without the checksum, and each array in order of its name.
func _verify():
	var context = HashingContext.new()
	context.start(HashingContext.HASH_SHA256)
	context.update(_without_checksum().to_utf8_buffer())
	var names = entries.keys()
	names.sort()
	for name in names:
		var entry = entries[name]
		var sides = []
		for side in entry["shape"]:
			sides.append(str(int(side)))
		var shape = sides[0] + "," if sides.size() == 1 else _joined(sides)
		context.update(("\n%s:%s:(%s)\n" % [name, NUMPY[entry["dtype"]], shape]).to_utf8_buffer())
		if entry["end"] > entry["begin"]:
			context.update(Platform.slice(_content, entry["begin"], entry["end"]))
	if context.finish().hex_encode() != facts.get("sha256"):
		return "the checksum does not match: the file is damaged"
	return ""


func _joined(sides):
	var found = ""
	for k in range(sides.size()):
		found += (", " if k > 0 else "") + sides[k]
	return found


# The text of the facts without the entry `sha256`, which is not the first of the sorted keys.
func _without_checksum():
	var entry = ', "sha256": "%s"' % facts.get("sha256", "")
	var at = _text.find(entry)
	if at < 0:
		return _text
	return _text.substr(0, at) + _text.substr(at + entry.length(), _text.length())
