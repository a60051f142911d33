"""The rig's figures for Prometheus, read when it asks."""

from collections.abc import Iterator

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from mrnav_server.app.rig_port import RigPort
from mrnav_server.app.twin import TwinHub
from mrnav_server.app.video import VideoHub
from mrnav_server.core.modes import Mode

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class RigCollector(Collector):
    """Reads the newest state and the hubs' counts.

    Args:
        rig: The rig.
        twin: Its twin clients are counted.
        video: Its video clients are counted.
    """

    def __init__(self, rig: RigPort, twin: TwinHub, video: VideoHub) -> None:
        self._rig = rig
        self._twin = twin
        self._video = video

    def text(self) -> bytes:
        """Return all figures in Prometheus' text format."""
        registry = CollectorRegistry()
        registry.register(self)
        return generate_latest(registry)

    def collect(self) -> Iterator[GaugeMetricFamily | CounterMetricFamily]:
        """Yield the figures; called by the registry."""
        simulated = float(self._rig.simulated)
        yield GaugeMetricFamily("mrnav_simulated", "1 while any device is simulated or emulated", simulated)
        yield GaugeMetricFamily("mrnav_ready", "1 when the rig is ready", float(not self._rig.readiness()))
        clients = GaugeMetricFamily("mrnav_clients", "Connected clients", labels=["stream"])
        dropped = CounterMetricFamily("mrnav_slow_readers", "Clients dropped as slow", labels=["stream"])
        for name, hub in (("twin", self._twin), ("video", self._video)):
            clients.add_metric([name], hub.clients)
            dropped.add_metric([name], hub.slow_readers)
        yield clients
        yield dropped
        yield from self._state()

    def _state(self) -> Iterator[GaugeMetricFamily | CounterMetricFamily]:
        state = self._rig.states.value
        if state is None:
            return
        yield CounterMetricFamily("mrnav_states", "States published", self._rig.states.version)
        yield GaugeMetricFamily(
            "mrnav_severity", "Worst active cause, 0 (none) to 4 (stop)", int(state.severity)
        )
        modes = GaugeMetricFamily("mrnav_mode", "1 for the mode in force", labels=["mode"])
        for mode in Mode:
            modes.add_metric([mode.value], float(mode is state.mode))
        yield modes
        rates = GaugeMetricFamily("mrnav_rate_hertz", "Measured rates", labels=["name"])
        for name, rate_hz in state.rates_hz.items():
            rates.add_metric([name], rate_hz)
        yield rates
        latency = GaugeMetricFamily("mrnav_latency_seconds", "Latencies", labels=["name", "quantile"])
        for name, value in state.latency_ms.items():
            latency.add_metric([name, "0.5"], value.p50 / 1000.0)
            latency.add_metric([name, "0.99"], value.p99 / 1000.0)
        yield latency
        counts = CounterMetricFamily("mrnav_events", "What happened how often", labels=["name"])
        for name, count in state.counters.items():
            counts.add_metric([name], count)
        yield counts
