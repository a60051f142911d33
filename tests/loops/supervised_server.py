"""A server in miniature, run as a process: it beats every 10 ms under a supervisor, to be killed and frozen.

    python supervised_server.py PORT REPORT_FILE m|i

Prints ``up`` with the supervisor's process id, and a line whenever the supervisor stopped the manipulator;
ends cleanly with its standard input.
"""

import asyncio
import sys
import time
from pathlib import Path

from mrnav_server.loops.supervisor import StopReport, StopTarget, Supervisor, SupervisorConfig
from mrnav_server.loops.ticks import ticks


def say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def on_report(report: StopReport) -> None:
    say(f"report {report.reason}")


async def beat(supervisor: Supervisor, moves: bool) -> None:
    async for _ in ticks(0.01, time.monotonic):
        supervisor.beat(moves)


async def main(port: int, report_file: Path, moves: bool) -> None:
    # The longest there is: a busy machine must not look like a hang.
    config = SupervisorConfig(hang_s=0.2)
    target = StopTarget("127.0.0.1", port, 1)
    supervisor = Supervisor(config, target, report_file, time.monotonic, say, on_report)
    async with supervisor, asyncio.TaskGroup() as group:
        beating = group.create_task(beat(supervisor, moves))
        await asyncio.sleep(0.1)
        assert supervisor._process is not None
        say(f"up {supervisor._process.pid}")
        await asyncio.to_thread(sys.stdin.read)
        beating.cancel()


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), Path(sys.argv[2]), sys.argv[3] == "m"))
