# Binary messages of a stream (docs/wire.md): pose messages are decoded, adverbs are encoded.
extends RefCounted

const Numbers = preload("numbers.gd")

const POSES = 0x01
const ADVERBS = 0x10
const BULK_ADVERBS = 0x11
const WIRE = 1
const MESSAGE_HEADER_BYTES = 20
const RECORD_HEADER_BYTES = 24
const MAX_MESSAGE_BYTES = 65536

const F32 = 0
const Q48 = 1
const WEIGHTS = 2
const Q32 = 3
const NAMES = ["f32", "q48", "weights", "q32"]

const CLAMPED = 1
const IN_TRANSITION = 2
const NEW_VERSION = 4
const LAST = 8


# Length of a record with `count` joints, or weights.
static func record_bytes(encoding, count):
	var payload = 12 + 16 * count
	if encoding == Q48:
		payload = 12 + 6 * count
	elif encoding == Q32:
		payload = 12 + 4 * count
	elif encoding == WEIGHTS:
		payload = 4 + 4 * count
	return RECORD_HEADER_BYTES + payload + (4 - payload % 4) % 4


# Layout that `opened` states: {encoding, count}; null where the length does not fit the joints.
static func layout_of(name, joints, length):
	var encoding = NAMES.find(name)
	if encoding < 0:
		return null
	var count = joints
	if encoding == WEIGHTS:
		count = int(floor((length - RECORD_HEADER_BYTES - 4) / 4.0))
	if count < 0 or record_bytes(encoding, count) != length:
		return null
	return {"encoding": encoding, "count": count}


# How well the examples support a pose, 0 to 1; -1 where the channel does not request it.
static func support_of(flags):
	return (flags >> 4) / 14.0 - 1.0 / 14.0 if flags >> 4 else -1.0


# Decode a pose message. `layouts` has the layout of each open channel.
# {problem, sequence, time_ns, dropped, records}; `problem` is empty where the message is valid. A record has channel,
# flags, version, phase, time_s, error (NAN: none), duration_s, encoding, and values: root x, y, z and x, y, z, w per
# joint, or weights.
static func decode(content, layouts):
	var found = {"problem": "", "sequence": 0, "time_ns": 0, "dropped": 0, "records": []}
	var length = content.size()
	if length < MESSAGE_HEADER_BYTES:
		return _malformed(found, "a message of %d bytes" % length)
	var stream = StreamPeerBuffer.new()
	stream.data_array = content
	var op = stream.get_u8()
	var wire = stream.get_u8()
	if op != POSES or wire != WIRE:
		return _malformed(found, "message %d of wire version %d" % [op, wire])
	var count = stream.get_u16()
	found["sequence"] = stream.get_u32()
	found["time_ns"] = stream.get_64()
	found["dropped"] = stream.get_u32()
	for _k in range(count):
		var problem = _read_record(stream, length, layouts, found["records"])
		if problem != "":
			return _malformed(found, problem)
	if stream.get_position() != length:
		return _malformed(found, "%d bytes after the last record" % (length - stream.get_position()))
	return found


static func _malformed(found, problem):
	found["problem"] = problem
	found["records"] = []
	return found


static func _read_record(stream, length, layouts, records):
	var start = stream.get_position()
	if length - start < RECORD_HEADER_BYTES:
		return "a record's header is cut"
	var record = {"channel": stream.get_u16(), "encoding": stream.get_u8(), "flags": stream.get_u8()}
	record["version"] = stream.get_u32()
	record["phase"] = stream.get_float()
	record["time_s"] = stream.get_float()
	record["error"] = stream.get_float()
	record["duration_s"] = stream.get_float()
	if not layouts.has(record["channel"]):
		return "a record of channel %d, which is not open" % record["channel"]
	var layout = layouts[record["channel"]]
	if layout["encoding"] != record["encoding"]:
		return "a record of encoding %d on channel %d" % [record["encoding"], record["channel"]]
	var size = layout["count"]
	if record["encoding"] == WEIGHTS:
		if length - stream.get_position() < 4:
			return "a record of weights ends before its count"
		size = stream.get_u16()  # a new version may have more examples
		stream.get_u16()
	var end = start + record_bytes(record["encoding"], size)
	if end > length:
		return "a record of channel %d is cut" % record["channel"]
	var values = _payload(stream, record["encoding"], size)
	for value in [record["phase"], record["time_s"], record["duration_s"]] + values:
		if is_nan(value) or is_inf(value):
			return "a number of channel %d is not finite" % record["channel"]
	record["values"] = values
	records.append(record)
	stream.seek(end)
	return ""


static func _payload(stream, encoding, size):
	var values = []
	if encoding == WEIGHTS:
		for _k in range(size):
			values.append(stream.get_float())
		return values
	for _k in range(3):
		values.append(stream.get_float())
	if encoding == F32:
		for _k in range(4 * size):
			values.append(stream.get_float())
	elif encoding == Q48:
		for _k in range(size):
			_append_q48(values, stream.get_u16(), stream.get_u16(), stream.get_u16())
	else:
		for _k in range(size):
			_append_q32(values, stream.get_u32())
	return values


static func _append_q48(values, first, second, third):
	var unit = 1.0 / (16383.0 * sqrt(2.0))
	_append_smallest(
		values,
		(first >> 15) + 2 * (second >> 15),
		((first & 0x7fff) - 16383) * unit,
		((second & 0x7fff) - 16383) * unit,
		((third & 0x7fff) - 16383) * unit
	)


static func _append_q32(values, word):
	var unit = 1.0 / (511.0 * sqrt(2.0))
	_append_smallest(
		values,
		word >> 30,
		((word & 0x3ff) - 511) * unit,
		(((word >> 10) & 0x3ff) - 511) * unit,
		(((word >> 20) & 0x3ff) - 511) * unit
	)


# Rotation of its three smaller components in the order x, y, z, w; `omitted` is the index of the fourth.
static func _append_smallest(values, omitted, a, b, c):
	var largest = sqrt(Numbers.most(0.0, 1.0 - a * a - b * b - c * c))
	if omitted == 0:
		values.append(largest)
	values.append(a)
	if omitted == 1:
		values.append(largest)
	values.append(b)
	if omitted == 2:
		values.append(largest)
	values.append(c)
	if omitted == 3:
		values.append(largest)


# Message 0x10: all adverbs of a channel.
static func encode_adverbs(channel, adverbs):
	var stream = StreamPeerBuffer.new()
	stream.put_u8(ADVERBS)
	stream.put_u8(0)
	stream.put_u16(channel)
	for value in adverbs:
		stream.put_float(value)
	return stream.data_array


# Message 0x11: all adverbs of many channels, one row for each; at most 64 KiB.
static func encode_bulk_adverbs(channels, rows):
	var stream = StreamPeerBuffer.new()
	stream.put_u8(BULK_ADVERBS)
	stream.put_u8(0)
	stream.put_u16(channels.size())
	for k in range(channels.size()):
		stream.put_u16(channels[k])
		stream.put_u16(0)
		for value in rows[k]:
			stream.put_float(value)
	return stream.data_array
