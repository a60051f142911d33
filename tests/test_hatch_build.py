"""The build hook fetches the pages' modules once, and leaves a usable folder alone."""

import importlib.util
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
_spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
assert _spec is not None
assert _spec.loader is not None
hatch_build = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(hatch_build)


class FakeNpm:
    """Writes every wanted file, and counts how often it was asked."""

    def __init__(self, leave_out: str = "") -> None:
        self.calls = 0
        self.leave_out = leave_out

    def __call__(self, folder: Path) -> None:
        self.calls += 1
        assert (folder / "package-lock.json").is_file()
        for source in hatch_build.VENDORED:
            if source != self.leave_out:
                target = folder / "node_modules" / source
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_text(source)


@pytest.fixture
def static(tmp_path: Path) -> Path:
    (tmp_path / "package.json").write_text("{}")
    (tmp_path / "package-lock.json").write_text("{}")
    return tmp_path


def test_first_build_copies_every_file_and_leaves_no_node_modules(static: Path) -> None:
    assert hatch_build.build_vendor(static, FakeNpm())
    for source, target in hatch_build.VENDORED.items():
        assert (static / "vendor" / target).read_text() == source
    assert not (static / "node_modules").exists()


def test_second_build_needs_no_npm(static: Path) -> None:
    hatch_build.build_vendor(static, FakeNpm())
    npm = FakeNpm()
    assert not hatch_build.build_vendor(static, npm)
    assert npm.calls == 0


@pytest.mark.parametrize("change", ["lock", "file"])
def test_changed_lock_or_lost_file_builds_again(static: Path, change: str) -> None:
    hatch_build.build_vendor(static, FakeNpm())
    if change == "lock":
        (static / "package-lock.json").write_text('{"lockfileVersion": 3}')
    else:
        (static / "vendor" / "uplot" / "LICENSE").unlink()
    npm = FakeNpm()
    assert hatch_build.build_vendor(static, npm)
    assert npm.calls == 1
    assert hatch_build.is_current(static)


def test_failed_install_keeps_the_old_folder(static: Path) -> None:
    hatch_build.build_vendor(static, FakeNpm())
    (static / "package-lock.json").write_text('{"lockfileVersion": 3}')
    with pytest.raises(RuntimeError, match="lack uplot/LICENSE"):
        hatch_build.build_vendor(static, FakeNpm(leave_out="uplot/LICENSE"))
    assert (static / "vendor" / "uplot" / "LICENSE").is_file()
    assert not hatch_build.is_current(static)


def test_lock_file_names_no_registry() -> None:
    lock = (ROOT / "static" / "package-lock.json").read_text(encoding="utf-8")
    assert '"resolved"' not in lock
    assert '"integrity"' in lock
