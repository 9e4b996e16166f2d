# Weights of adverbs: clamp to the domain, then a cardinal basis (methods `rbf` and `refined`).
extends RefCounted

const Numbers = preload("numbers.gd")

const CYLINDER = 1
const PLANAR = 2
const TURN = 2.0 * PI
const FREE_GAUGE = 1.08
const LAST_GAUGE = 1.25

var _dims
var _examples
var _domain
var _bases = {}


# Read domain and bases of a verb file, which has a problem where they do not fit.
func _init(file):
	_dims = file.facts["adverbs"].size()
	_examples = file.facts["examples"].size()
	_domain = {
		"chart": _chart(file, "domain", file.facts["domain"]["chart"]),
		"facets": file.numbers("domain.facets", [-1, _dims]),
		"middle": file.numbers("domain.middle", [_dims]),
		"sharpness": file.facts["domain"]["sharpness"],
	}
	for name in file.facts["bases"]:
		var row = file.facts["bases"][name]
		var features = [1, _dims + 1, 1 + _dims + _dims * (_dims + 1) / 2][int(row["degree"])]
		var prefix = "bases." + name
		_bases[name] = {
			"chart": _chart(file, prefix, row["chart"]),
			"kernel": int(row["kernel"]),
			"degree": int(row["degree"]),
			"centers": file.numbers(prefix + ".centers", [-1, _dims]),
			"radii": file.numbers(prefix + ".radii", [-1]),
			"radial": file.numbers(prefix + ".radial", [-1, _examples]),
			"poly": file.numbers(prefix + ".poly", [features, _examples]),
		}


func _chart(file, prefix, kind):
	return {
		"kind": int(kind),
		"axes": file.numbers(prefix + ".chart.axes", [3]),
		"bend": file.numbers(prefix + ".chart.bend", [4]),
		"shift": file.numbers(prefix + ".chart.shift", [_dims]),
		"scale": file.numbers(prefix + ".chart.scale", [_dims]),
	}


# {weights, clamped} of adverbs in the verb's order. A verb without pseudo-examples has the weights of `rbf` as `refined`.
func weights(adverbs, method):
	var basis = _bases[method] if _bases.has(method) else _bases["rbf"]
	var moved = _clamp(adverbs)
	var point = _to_chart(basis["chart"], moved["adverbs"])
	var found = []
	for _k in range(_examples):
		found.append(0.0)
	var row = 0
	if basis["degree"] >= 1:
		for a in range(_dims):
			_add(found, point[a], basis["poly"], row)
			row += 1
	if basis["degree"] >= 2:
		for a in range(_dims):
			for b in range(a, _dims):
				_add(found, point[a] * point[b], basis["poly"], row)
				row += 1
	_add(found, 1.0, basis["poly"], row)
	for c in range(basis["radii"].size()):
		var squared = 0.0
		for a in range(_dims):
			var difference = point[a] - basis["centers"][c * _dims + a]
			squared += difference * difference
		var value = _radial(basis["kernel"], sqrt(squared) / basis["radii"][c])
		if value != 0.0:
			_add(found, value, basis["radial"], c)
	return {"weights": found, "clamped": moved["clamped"]}


func _add(out, share, coefficients, row):
	for k in range(_examples):
		out[k] += share * coefficients[row * _examples + k]


# Radial function at scaled distance r.
func _radial(kernel, r):
	match kernel:
		0:
			if r >= 2.0:
				return 0.0
			return pow(2.0 - r, 3.0) / 6.0 if r >= 1.0 else 2.0 / 3.0 - r * r + 0.5 * r * r * r
		1:
			return -sqrt(r * r + 1.0)
		2:
			return -r
		3:
			return r * r * log(r) if r > 0.0 else 0.0
		4:
			return r * r * r
	return pow(1.0 - 0.5 * r, 4.0) * (2.0 * r + 1.0) if r < 2.0 else 0.0


# Normalised chart coordinates of adverbs.
func _to_chart(chart, adverbs):
	var out = adverbs.duplicate()
	var i = chart["axes"][0]
	var j = chart["axes"][1]
	var m = chart["axes"][2]
	var bend = chart["bend"]
	if chart["kind"] == CYLINDER:
		var x = adverbs[i] - bend[0]
		var z = adverbs[m] - bend[1]
		out[i] = bend[3] * fposmod(atan2(x, z) - bend[2], TURN)
		out[m] = sqrt(x * x + z * z)
	elif chart["kind"] == PLANAR:
		var direction = adverbs[j] * (bend[0] if bend[0] != 0.0 else 1.0)
		out[i] = adverbs[i] * sin(direction)
		out[j] = adverbs[i] * cos(direction)
	for a in range(_dims):
		out[a] = (out[a] - chart["shift"][a]) * chart["scale"][a]
	return out


# Adverbs of normalised chart coordinates.
func _from_chart(chart, point):
	var out = []
	for a in range(_dims):
		out.append(point[a] / chart["scale"][a] + chart["shift"][a])
	var i = chart["axes"][0]
	var j = chart["axes"][1]
	var m = chart["axes"][2]
	var bend = chart["bend"]
	if chart["kind"] == CYLINDER:
		var angle = out[i] / bend[3] + bend[2]
		var radius = out[m]
		out[i] = bend[0] + radius * sin(angle)
		out[m] = bend[1] + radius * cos(angle)
	elif chart["kind"] == PLANAR:
		var x = out[i]
		var z = out[j]
		out[i] = sqrt(x * x + z * z)
		out[j] = atan2(x, z) / (bend[0] if bend[0] != 0.0 else 1.0) if x != 0.0 or z != 0.0 else 0.0
	return out


# Smooth gauge of a point: 1 on the surface of the domain.
func _gauge(point):
	var middle = _domain["middle"]
	var facets = _domain["facets"]
	var values = []
	var top = 0.0
	for f in range(facets.size() / _dims):
		var value = 0.0
		for a in range(_dims):
			value += facets[f * _dims + a] * (point[a] - middle[a])
		values.append(value)
		top = Numbers.most(top, value)
	if top <= 0.0:
		return 0.0
	var total = 0.0
	for value in values:
		if value > 0.0:
			total += pow(value / top, _domain["sharpness"])
	return top * pow(total, 1.0 / _domain["sharpness"])


# {adverbs, clamped}: the identity up to gauge 1.08, then a hyperbolic tangent that never passes 1.25.
func _clamp(adverbs):
	var point = _to_chart(_domain["chart"], adverbs)
	var value = _gauge(point)
	if value <= FREE_GAUGE:
		return {"adverbs": adverbs.duplicate(), "clamped": false}
	var span = LAST_GAUGE - FREE_GAUGE
	var shrink = (FREE_GAUGE + span * tanh((value - FREE_GAUGE) / span)) / value
	for a in range(_dims):
		point[a] = _domain["middle"][a] + (point[a] - _domain["middle"][a]) * shrink
	return {"adverbs": _from_chart(_domain["chart"], point), "clamped": true}
