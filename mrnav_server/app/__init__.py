"""The server: the rig, REST, WebSockets, video."""
