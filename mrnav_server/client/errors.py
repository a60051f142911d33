"""What can go wrong between a client and the server."""

from mrnav_server.core.errors import MrnavError


class ConnectionEndedError(MrnavError):
    """The server is not there, refuses, or ended the connection. Reaction: the client's owner decides."""
