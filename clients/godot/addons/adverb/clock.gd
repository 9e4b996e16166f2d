# Estimate of the server's clock by pings: that of the shortest round trip of the last minute counts.
extends RefCounted

const WINDOW_S = 60.0
const MAX_PINGS = 256

var _pings = []


# Add a ping; one that arrives before it was sent is ignored.
func add(sent_s, arrived_s, server_time_ns):
	if arrived_s < sent_s:
		return
	_pings.append([arrived_s, arrived_s - sent_s, server_time_ns * 1e-9 - 0.5 * (sent_s + arrived_s)])
	while _pings.size() > MAX_PINGS or _pings[0][0] < arrived_s - WINDOW_S:
		_pings.pop_front()


# Discard all pings; another server has another clock.
func clear():
	_pings.clear()


func known():
	return _pings.size() > 0


# Shortest round trip, s; NAN before the first ping.
func round_trip_s():
	return _best()[1] if known() else NAN


# Server's clock minus this machine's, s; NAN before the first ping.
func offset_s():
	return _best()[2] if known() else NAN


func _best():
	var best = _pings[0]
	for ping in _pings:
		if ping[1] < best[1]:
			best = ping
	return best
