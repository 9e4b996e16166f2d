# A WebSocket, polled. This file is for Godot 3; addons/adverb/socket.gd has the same for Godot 4.
extends Reference

const MAX_MESSAGE_KIB = 4096
const MAX_PACKETS = 4096

var _client = WebSocketClient.new()
var _peer = null
var _closed = false
var _code = 0
var _reason = "the connection was refused"


# Start the handshake; false where the address is not valid.
func open(url, protocols):
	_client.set_buffers(MAX_MESSAGE_KIB, MAX_PACKETS, 256, MAX_PACKETS)
	_client.connect("connection_established", self, "_on_established")
	_client.connect("connection_error", self, "_on_closed")
	_client.connect("connection_closed", self, "_on_closed")
	_client.connect("server_close_request", self, "_on_close_request")
	return _client.connect_to_url(url, PoolStringArray(protocols)) == OK


func _on_established(_protocol):
	_peer = _client.get_peer(1)
	_reason = "the connection ended"


func _on_closed(_clean = false):
	_closed = true


func _on_close_request(code, text):
	_code = code
	_reason = "the connection ended: %d %s" % [code, text]


func poll():
	_client.poll()


# Messages that have arrived: texts and bytes.
func take():
	var found = []
	while _peer != null and _peer.get_available_packet_count() > 0:
		var content = _peer.get_packet()
		found.append(content.get_string_from_utf8() if _peer.was_string_packet() else content)
	return found


# Send a text or bytes.
func send(message):
	if _peer == null or not _peer.is_connected_to_host():
		return
	if typeof(message) == TYPE_STRING:
		_peer.set_write_mode(WebSocketPeer.WRITE_MODE_TEXT)
		_peer.put_packet(message.to_utf8())
	else:
		_peer.set_write_mode(WebSocketPeer.WRITE_MODE_BINARY)
		_peer.put_packet(message)


func closed():
	return _closed


func close_code():
	return _code


func reason():
	return _reason


# Close the connection with code 1000.
func close():
	_client.disconnect_from_host(1000)
	_client.poll()


# Break a connection that is not needed any more.
func drop():
	if not _closed:
		_client.disconnect_from_host()
	_peer = null
