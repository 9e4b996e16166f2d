# Nothing to set up: the node AdverbFigure registers itself.
@tool
extends EditorPlugin
