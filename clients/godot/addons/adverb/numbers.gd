# Minimum, maximum and bounds in double precision: those of Godot 3 round to single precision.
extends RefCounted


static func least(a, b):
	return a if a < b else b


static func most(a, b):
	return a if a > b else b


static func bounded(value, low, high):
	return low if value < low else (high if value > high else value)
