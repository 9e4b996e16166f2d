# Runs one function of a test program and prints what it returns as a line of JSON.
extends SceneTree

const Platform = preload("res://addons/adverb/platform.gd")


func _initialize():
	var arguments = JSON.parse(OS.get_environment("ADVERB_PROGRAM")).result
	emit(callv(arguments[0], arguments[1]))
	quit()


func emit(value):
	print("JSON " + Platform.json_text(plain(value)))


# The value with null for numbers that JSON does not have.
func plain(value):
	match typeof(value):
		TYPE_REAL:
			return null if is_nan(value) or is_inf(value) else value
		TYPE_DICTIONARY:
			var fields = {}
			for name in value:
				fields[name] = plain(value[name])
			return fields
		TYPE_ARRAY:
			var items = []
			for item in value:
				items.append(plain(item))
			return items
	return value


func read_bytes(path):
	var file = File.new()
	assert(file.open(path, File.READ) == OK)
	return file.get_buffer(file.get_len())


func read_json(path):
	return JSON.parse(read_bytes(path).get_string_from_utf8()).result


func bytes_of(hex):
	var found = PoolByteArray()
	for k in range(0, hex.length(), 2):
		found.append(("0x" + hex.substr(k, 2)).hex_to_int())
	return found
