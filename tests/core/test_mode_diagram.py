"""The diagram of the modes shows the table as it is."""

from pathlib import Path

import pytest

from mrnav_server.core import mode_diagram
from mrnav_server.core.modes import Ask, Facts, ModeMachine
from tests.loops.test_control_stateful import TRANSITIONS

DOCS = Path(__file__).parents[2] / "docs"
AGAIN = "the modes have changed: run python docs/draw_modes.py"


def test_the_documents_show_the_table_as_it_is() -> None:
    edges, page = mode_diagram.transitions(), (DOCS / "safety.md").read_text(encoding="utf-8")
    assert mode_diagram.mermaid(edges) in page, AGAIN
    assert page == mode_diagram.page_with(page, edges), AGAIN
    assert (DOCS / mode_diagram.PICTURE).read_text(encoding="utf-8") == mode_diagram.svg(edges), AGAIN


def test_the_diagram_has_every_transition_and_no_other() -> None:
    assert set(mode_diagram.transitions()) == TRANSITIONS


def test_another_table_gives_another_diagram(monkeypatch: pytest.MonkeyPatch) -> None:
    before = mode_diagram.mermaid(mode_diagram.transitions())
    check = ModeMachine.check

    def lenient(self: ModeMachine, ask: Ask, facts: Facts) -> None:
        if ask is not Ask.RESET:
            check(self, ask, facts)

    monkeypatch.setattr(ModeMachine, "check", lenient)
    assert mode_diagram.mermaid(mode_diagram.transitions()) != before
