"""A Foxglove server that sends a state of the twin's size, for comparison; needs ``foxglove-sdk``.

Run by the benchmark of the twin: ``python -m benchmarks._twin_foxglove``. Prints its port, then sends 60 a
second until it is ended.
"""

import importlib
import json
import sys
import time

PATH = "/"
PROTOCOL = "foxglove.sdk.v1"
SUBSCRIBE = '{"op":"subscribe","subscriptions":[{"id":1,"channelId":1}]}'
_RATE_HZ = 60.0


def main() -> None:
    """Serve the state that comes as one line on standard input, with the time put into it."""
    foxglove = importlib.import_module("foxglove")

    state = json.loads(sys.stdin.readline())
    server = foxglove.start_server(host="127.0.0.1", port=0)
    channel = foxglove.Channel("/twin", schema={"type": "object"}, message_encoding="json")
    print(json.dumps({"port": server.port, "channel": channel.id()}), flush=True)
    due_s = time.monotonic()
    while True:
        due_s += 1.0 / _RATE_HZ
        time.sleep(max(0.0, due_s - time.monotonic()))
        whole = {"type": "state", "t": round(time.monotonic(), 6), **state}
        channel.log(json.dumps(whole, separators=(",", ":")).encode())


if __name__ == "__main__":
    main()
