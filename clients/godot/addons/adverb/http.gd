# One HTTP request, polled: `start`, then `poll` once per frame until it returns true.
extends RefCounted

const Platform = preload("platform.gd")

# Longest time of the request, s.
var timeout_s = 10.0
# Status of the response; 0 where there is none.
var status = 0
# Content of the response.
var body = PackedByteArray()
# Why there is no response; empty where there is one.
var problem = ""

var _client = HTTPClient.new()
var _request = []
var _sent = false
var _end_s = 0.0


# Start a request. `address`: http:// or https:// with host and port, and maybe a path; `key` and `content` may be empty.
func start(address, method, path, key, content):
	var secure = address.begins_with("https://")
	var host = address.substr(8 if secure else 7, address.length()).rstrip("/")
	var slash = host.find("/")
	if slash >= 0:
		path = host.substr(slash, host.length()) + path
		host = host.substr(0, slash)
	var port = 443 if secure else 80
	var colon = host.rfind(":")
	if colon > 0 and host.find("]") < colon:
		port = int(host.substr(colon + 1, host.length()))
		host = host.substr(0, colon)
	var headers = PackedStringArray(["Accept: application/json, application/octet-stream"])
	if key != "":
		headers.append("Authorization: Bearer " + key)
	if content != "":
		headers.append("Content-Type: application/json")
	_request = [HTTPClient.METHOD_POST if method == "POST" else HTTPClient.METHOD_GET, path, headers, content]
	_end_s = Platform.now_s() + timeout_s
	if Platform.connect_http(_client, host, port, secure) != OK:
		problem = "the address %s is not valid" % address


# Continue; true where the response is complete, or there is none.
func poll():
	if problem == "" and Platform.now_s() > _end_s:
		problem = "no response within %.1f s" % timeout_s
	if problem != "":
		_client.close()
		return true
	_client.poll()
	match _client.get_status():
		HTTPClient.STATUS_RESOLVING, HTTPClient.STATUS_CONNECTING, HTTPClient.STATUS_REQUESTING:
			return false
		HTTPClient.STATUS_CONNECTED:
			if _sent:
				status = _client.get_response_code()
				return true
			_sent = true
			_client.request(_request[0], _request[1], _request[2], _request[3])
			return false
		HTTPClient.STATUS_BODY:
			status = _client.get_response_code()
			body.append_array(_client.read_response_body_chunk())
			return false
	if _sent and status > 0:
		return true  # the server closed the connection after the response
	problem = "no connection"
	return false


# The content as text.
func text():
	return body.get_string_from_utf8()
