"""The kernels' cache knows when what a kernel calls has changed in another file."""

import subprocess
import sys
from pathlib import Path

import numba
import pytest

from robots import kernel_types
from robots.kernel_types import CACHE_FOLDER, CACHE_PREFIX, PACKAGES, njit, sources_digest

CALLED = """
from robots.kernel_types import njit
@njit(cache=True)
def called(x):
    return x + {added}
"""

CALLER = """
from robots.kernel_types import njit
from wbc.called import called
@njit(cache=True)
def caller(x):
    return called(x)
"""


@pytest.fixture
def root(tmp_path: Path) -> Path:
    for package in PACKAGES:
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("")
    (tmp_path / "robots" / "kernel_types.py").write_text(Path(kernel_types.__file__).read_text(encoding="utf-8"))
    (tmp_path / "safety" / "caller.py").write_text(CALLER)
    return tmp_path


def called(root: Path, added: int) -> int:
    """What a kernel says that calls one of another file, in a process of its own."""
    (root / "wbc" / "called.py").write_text(CALLED.format(added=added))
    code = "from safety.caller import caller; print(caller(1))"
    out = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=True)
    return int(out.stdout)


def test_a_kernel_is_compiled_anew_where_what_it_calls_has_changed(root: Path) -> None:
    assert called(root, 1) == 2
    assert called(root, 10) == 11
    assert called(root, 1) == 2
    assert len(list((root / "robots" / "__pycache__").glob(f"{CACHE_PREFIX}*"))) == 2


def test_the_digest_heeds_kernels_and_constants_and_nothing_else(root: Path) -> None:
    other = root / "sims" / "other.py"
    other.write_text('"""Words."""\nGRAVITY = 9.81\nx = 1\n')
    first = sources_digest(root)
    other.write_text('"""Other words."""\nGRAVITY = 9.81\nx = 2\n')
    assert sources_digest(root) == first
    other.write_text('"""Words."""\nGRAVITY = 9.80\nx = 1\n')
    assert sources_digest(root) != first
    other.write_text('"""Words."""\nGRAVITY = 9.81\nx = 1\n')
    assert sources_digest(root) == first
    (root / "safety" / "caller.py").write_text(CALLER + "# and more\n")
    assert sources_digest(root) != first


def test_what_others_compile_is_kept_where_it_always_was() -> None:
    before = vars(numba.config)["CACHE_DIR"]

    @njit()
    def own(x: float) -> float:
        return 2.0 * x

    assert own(2.0) == 4.0
    assert before == vars(numba.config)["CACHE_DIR"]
    assert CACHE_FOLDER.name.startswith(CACHE_PREFIX)


def test_the_cache_is_where_it_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    file.write_text("")
    assert kernel_types.can_be_written(tmp_path / "new" / "and" / "newer")
    assert not kernel_types.can_be_written(file / "below")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    own = kernel_types.OWN_FOLDER
    for given, writable, expected in (
        ("", (own, tmp_path / "safewbc"), own),
        ("", (tmp_path / "safewbc",), tmp_path / "safewbc"),
        ("", (), own),
        ("/named", (own, Path("/named")), Path("/named")),
        ("/named", (own,), Path("/named")),
    ):
        monkeypatch.setattr(numba.config, "CACHE_DIR", given)
        monkeypatch.setattr(kernel_types, "can_be_written", lambda folder, writable=writable: folder in writable)
        assert kernel_types.cache_folder().parent == expected
