"""axe-core in a page: what a person with a disability would stumble over."""

from pathlib import Path

from playwright.sync_api import Page

_AXE = Path(__file__).parents[2] / "static" / "node_modules" / "axe-core" / "axe.min.js"


def stumbling_blocks(page: Page) -> list[str]:
    """Return what axe-core objects to, one line each."""
    page.evaluate(_AXE.read_text(encoding="utf-8"))
    found = page.evaluate("axe.run().then(({violations}) => violations)")
    return [
        f"{rule['id']}: {node['target']} {node['failureSummary']}" for rule in found for node in rule["nodes"]
    ]
