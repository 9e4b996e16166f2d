# A WebSocket, polled. This file is for Godot 4; godot3/socket.gd has the same for Godot 3.
extends RefCounted

const MAX_MESSAGE_BYTES = 1 << 22

var _peer = WebSocketPeer.new()
var _was_open = false


# Start the handshake; false where the address is not valid.
func open(url, protocols):
	_peer.supported_protocols = PackedStringArray(protocols)
	_peer.inbound_buffer_size = MAX_MESSAGE_BYTES
	_peer.max_queued_packets = 4096
	return _peer.connect_to_url(url) == OK


func poll():
	_peer.poll()
	_was_open = _was_open or _peer.get_ready_state() == WebSocketPeer.STATE_OPEN


# Messages that have arrived: texts and bytes.
func take():
	var found = []
	while _peer.get_available_packet_count() > 0:
		var content = _peer.get_packet()
		found.append(content.get_string_from_utf8() if _peer.was_string_packet() else content)
	return found


# Send a text or bytes.
func send(message):
	if typeof(message) == TYPE_STRING:
		_peer.send_text(message)
	else:
		_peer.send(message)


func closed():
	return _peer.get_ready_state() == WebSocketPeer.STATE_CLOSED


func close_code():
	return max(_peer.get_close_code(), 0) if closed() else 0


func reason():
	if not _was_open:
		return "the connection was refused"
	return "the connection ended: %d %s" % [close_code(), _peer.get_close_reason()]


# Close the connection with code 1000.
func close():
	_peer.close(1000)
	_peer.poll()


# Break a connection that is not needed any more.
func drop():
	_peer.close(-1)
