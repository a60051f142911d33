"""Jobs on a Ray cluster: the same function as on this machine, one processor each."""

import logging
import socket
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mrnav_server.core.errors import ConfigError
from mrnav_server.training.sweep import Event, Events, PooledJob, Work, dead, settled
from mrnav_server.training.sweep_job import run_job

_REACH_S = 5.0


def connect(address: str) -> None:
    """Join a Ray cluster that runs.

    Args:
        address: ``host:port`` of its head, or ``auto`` for the cluster that this machine belongs to.

    Raises:
        ConfigError: If Ray is not installed, or there is no cluster.
    """
    ray = _ray()
    host, colon, port = address.rpartition(":")
    try:
        if colon and port.isdigit() and "/" not in host:
            socket.create_connection((host, int(port)), _REACH_S).close()  # Ray itself tries for minutes.
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())[:300]
        raise ConfigError(
            f"cannot join a Ray cluster at {address!r}: start one with 'ray start --head', and join it from"
            f" other machines with 'ray start --address=HOST:PORT' ({reason})"
        ) from None


def run_on_ray(jobs: Sequence[PooledJob], out: Path, work: Work = run_job) -> Events:
    """Run jobs on the cluster that `connect` joined; ending the iteration early ends them.

    Args:
        jobs: Each job once.
        out: Gets one folder per job; an absolute path that every node sees, for example on a network drive.
        work: What is done with each.
    """
    ray = _ray()
    # Ray could start a job again by itself, but then nobody is told which jobs take their workers down.
    remote = ray.remote(num_cpus=1, max_retries=0)(work)
    running: dict[Any, PooledJob] = {remote.remote(job.spec(), out / job.name): job for job in jobs}
    lost = Counter[PooledJob]()
    try:
        while running:
            ended, _ = ray.wait(list(running), num_returns=1)
            for reference in ended:
                job = running.pop(reference)
                event = _end(ray, reference, job, out, lost)
                if event.kind == "lost":
                    running[remote.remote(job.spec(), out / job.name)] = job
                yield event
    finally:
        for reference in running:
            ray.cancel(reference, force=True)
        ray.shutdown()


def _end(ray: Any, reference: object, job: PooledJob, out: Path, lost: Counter[PooledJob]) -> Event:  # noqa: ANN401
    """Return what became of a job that ended, and count the workers that it lost."""
    try:
        ray.get(reference)
    except ray.exceptions.RayTaskError as error:  # A node that could not even start it, or write its folder.
        return Event(job, "failed", str(error).strip().splitlines()[-1])
    except ray.exceptions.RayError as error:
        lost[job] += 1
        return settled(job, out) or dead(job, lost[job], " ".join(str(error).split())[:300])
    unseen = f"its node wrote to {out}, which this machine does not see: share that folder among the nodes"
    return settled(job, out) or Event(job, "failed", unseen)


def _ray() -> Any:  # noqa: ANN401 - a package that may be missing
    try:
        import ray
        import ray.exceptions
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "ray":
            raise
        raise ConfigError("--ray needs Ray: pip install 'mrnav-server[ray]'") from None
    return ray
