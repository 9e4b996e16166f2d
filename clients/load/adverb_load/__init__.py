"""Parts of the load scripts: a minimal WebSocket client that keeps up with a server, what it plays, what it counts."""
