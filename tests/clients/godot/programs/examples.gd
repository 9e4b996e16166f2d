# The examples of the README against a server, until each has a pose.
extends SceneTree

const Figure = preload("res://addons/adverb/adverb_figure.gd")
const Http = preload("res://addons/adverb/http.gd")
const Platform = preload("res://addons/adverb/platform.gd")

const PATIENCE_S = 30.0

var _node
var _stream
var _evaluation
var _http = Http.new()
var _steered = false
var _displayed = 0
var _values = []
var _opened = []


func _initialize():
	var settings = JSON.parse(OS.get_environment("ADVERB_PROGRAM")).result
	_node = load(settings["paths"][0]).new()
	var figure = Figure.new()
	figure.set_name("AdverbFigure")
	figure.server = settings["server"]
	figure.add_child(Skeleton.new())
	figure.connect("reported", self, "_on_reported")
	_node.add_child(figure)
	root.add_child(_node)
	_stream = load(settings["paths"][1]).new()
	root.add_child(_stream)
	_evaluation = load(settings["paths"][2]).new()
	_http.start(settings["server"], "GET", "/v1/verbs/reach/artifact", "", "")


func _on_reported(event):
	if event["kind"] == "opened":
		_opened.append(event["name"])


func _idle(_delta):
	OS.delay_msec(2)
	if not _steered and _node.get_node("AdverbFigure").pose != null:
		_steered = true
		_node.run()
	if _stream.stream.sample(_stream.number) != null:
		_displayed += 1
	if _values.empty() and _http.poll():
		_values = _evaluation.run(_http)["values"]
	var done = _opened.size() > 1 and _displayed > 5 and not _values.empty()
	if not done and OS.get_ticks_msec() < PATIENCE_S * 1000.0:
		return false
	var events = _node.events
	print("JSON " + Platform.json_text({"opened": _opened, "events": events, "displayed": _displayed, "values": _values}))
	_evaluation.free()
	quit()
	return true
