"""The diagram of the modes, drawn from what the mode machine does; ``docs/draw_modes.py`` writes it."""

import copy
import itertools
import math
import re
from xml.sax.saxutils import escape

from mrnav_server.core.errors import RefusedError
from mrnav_server.core.modes import Ask, Facts, Mode, ModeMachine

Edges = dict[tuple[Mode, Mode], tuple[str, ...]]
PICTURE = "modes.svg"
_BLOCK = re.compile(r"(?<=<!-- modes -->\n).*?(?=<!-- /modes -->)", re.DOTALL)
_CALM = Facts(leased=True, hand_fresh=True, clutch_closing=False, at_rest=True, arrived=False)
_PLACES = {
    Mode.DISARMED: (110, 260),
    Mode.HOLD: (480, 260),
    Mode.MANUAL: (480, 80),
    Mode.AUTO: (890, 80),
    Mode.FAULT: (480, 420),
    Mode.STOP: (890, 420),
}
_COLOURS = {
    Mode.DISARMED: "#e8eaed",
    Mode.HOLD: "#fdecc8",
    Mode.MANUAL: "#d6ecd8",
    Mode.AUTO: "#d5e6fa",
    Mode.FAULT: "#f9d7d3",
    Mode.STOP: "#f4b9b3",
}
_HALF_W, _HALF_H = 62, 26


def transitions() -> Edges:
    """Return every change of mode that the machine makes, with what brings it about.

    Each ask and each change of one fact is tried in each mode; a chain within one step counts by its ends.
    """
    starts = _starts()
    edges: dict[tuple[Mode, Mode], list[str]] = {}
    for start, (cause, ask, facts) in itertools.product(starts, _causes()):
        machine = copy.copy(start)
        try:
            if ask is not None:
                machine.check(ask, facts)
        except RefusedError:
            continue
        machine.settle([] if ask is None else [ask], facts)
        pair = (start.mode, machine.mode)
        if pair[0] is not pair[1] and cause not in edges.setdefault(pair, []):
            edges[pair].append(cause)
    return {pair: tuple(causes) for pair, causes in edges.items()}


def mermaid(edges: Edges) -> str:
    """Return the diagram as Mermaid."""
    lines = ["stateDiagram-v2", "    [*] --> DISARMED"]
    lines += [f"    {a.value} --> {b.value}: {', '.join(causes)}" for (a, b), causes in edges.items()]
    return "\n".join(lines)


def svg(edges: Edges) -> str:
    """Return the diagram as a picture; STOP and FAULT, which come from everywhere, are told below it."""
    everywhere = {Mode.STOP, Mode.FAULT}
    drawn = {pair: causes for pair, causes in edges.items() if pair[1] not in everywhere}
    parts = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1000 520" font-family="system-ui, sans-serif">',
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0 0 8 4 0 8z" fill="#5f6368"/></marker></defs>',
        '<rect width="1000" height="520" fill="#ffffff"/>',
    ]
    parts += [_arrow(a, b) for a, b in drawn]
    parts += [_box(mode) for mode in Mode]
    parts += [_label(a, b, causes) for (a, b), causes in drawn.items()]
    for y, mode in ((488, Mode.STOP), (508, Mode.FAULT)):
        sources = ", ".join(a.value for a, b in edges if b is mode)
        causes = ", ".join(sorted({cause for (_, b), all_ in edges.items() if b is mode for cause in all_}))
        parts.append(_text(500, y, f"{mode.value}: {causes}, from {sources}", 13))
    return "\n".join((*parts, "</svg>", ""))


def page_with(text: str, edges: Edges) -> str:
    """Return a page with the diagram between its two marks renewed."""
    block = f"\n![The modes and what leads from one to another]({PICTURE})\n\n"
    block += f"```mermaid\n{mermaid(edges)}\n```\n\n"
    return _BLOCK.sub(lambda _: block, text)


def _starts() -> list[ModeMachine]:
    """Return a machine in each mode."""
    asks = {
        Mode.DISARMED: (),
        Mode.MANUAL: (Ask.ARM,),
        Mode.AUTO: (Ask.ARM, Ask.AUTO),
        Mode.HOLD: (Ask.ARM, Ask.HOLD),
        Mode.FAULT: (),
        Mode.STOP: (Ask.STOP,),
    }
    machines = []
    for mode, way in asks.items():
        machine = ModeMachine()
        for ask in way:
            machine.settle([ask], _CALM)
        if mode is Mode.FAULT:
            machine.settle([], Facts(True, True, False, True, False, fault="broken"))
        machines.append(machine)
    return machines


def _causes() -> list[tuple[str, Ask | None, Facts]]:
    def when(**changed: bool | str) -> Facts:
        values = {name: getattr(_CALM, name) for name in Facts.__dataclass_fields__}
        return Facts(**(values | changed))

    return [
        *((ask.value, ask, _CALM) for ask in Ask),
        ("arm without a hand", Ask.ARM, when(hand_fresh=False)),
        ("disarm in motion", Ask.DISARM, when(at_rest=False)),
        ("clutch closes", None, when(clutch_closing=True)),
        ("arrival", None, when(arrived=True)),
        ("arrival without a hand", None, when(arrived=True, hand_fresh=False)),
        ("hand silent", None, when(hand_fresh=False)),
        ("lease lost", None, when(leased=False)),
        ("guard fails", None, when(auto_refusal="guard")),
        ("fault", None, when(fault="broken")),
    ]


def _arrow(a: Mode, b: Mode) -> str:
    (x1, y1), (x2, y2) = _ends(a, b)
    return f'<path d="M{x1:.0f} {y1:.0f} {x2:.0f} {y2:.0f}" stroke="#5f6368" marker-end="url(#tip)"/>'


def _ends(a: Mode, b: Mode) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return where an arrow begins and ends: on the edges of the boxes, beside the one that comes back."""
    (ax, ay), (bx, by) = _PLACES[a], _PLACES[b]
    length = math.hypot(bx - ax, by - ay)
    ux, uy = (bx - ax) / length, (by - ay) / length
    away = min(_HALF_W / max(abs(ux), 1e-9), _HALF_H / max(abs(uy), 1e-9)) + 4.0
    side_x, side_y = -7.0 * uy, 7.0 * ux
    return (ax + away * ux + side_x, ay + away * uy + side_y), (
        bx - away * ux + side_x,
        by - away * uy + side_y,
    )


def _label(a: Mode, b: Mode, causes: tuple[str, ...]) -> str:
    """Return the causes beside their arrow, on the side away from the one that comes back."""
    (x1, y1), (x2, y2) = _ends(a, b)
    length = math.hypot(x2 - x1, y2 - y1)
    side_x, side_y = -(y2 - y1) / length, (x2 - x1) / length
    rows = len(causes) - 1
    x, y = 0.55 * x1 + 0.45 * x2 + 8.0 * side_x, 0.55 * y1 + 0.45 * y2 + 4.0
    if abs(side_x) < 0.3:
        anchor, first = "middle", y + 11.0 * side_y - (13.0 * rows if side_y < 0 else 0.0)
    else:
        anchor, first = "end" if side_x < 0 else "start", y - 6.5 * rows
    return "".join(_text(x, first + 13.0 * row, cause, 11, anchor) for row, cause in enumerate(causes))


def _box(mode: Mode) -> str:
    x, y = _PLACES[mode]
    size = f'width="{2 * _HALF_W}" height="{2 * _HALF_H}" rx="10"'
    place = f'x="{x - _HALF_W}" y="{y - _HALF_H}"'
    return f'<rect {place} {size} fill="{_COLOURS[mode]}" stroke="#5f6368"/>' + _text(
        x, y + 6, mode.value, 16
    )


def _text(x: float, y: float, text: str, size: int, anchor: str = "middle") -> str:
    halo = 'paint-order="stroke" stroke="#ffffff" stroke-width="3"' if size == 11 else ""
    return (
        f'<text x="{x:.0f}" y="{y:.0f}" font-size="{size}" text-anchor="{anchor}" fill="#202124" {halo}>'
        f"{escape(text)}</text>"
    )
