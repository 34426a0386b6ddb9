"""What is said where packages of others stand in the place of ours."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from safewbc.installation import HOME, PACKAGES, installation_problem

ROOT = Path(__file__).resolve().parents[1]


def call(arguments: list[str], *paths: Path) -> tuple[int, str]:
    """Exit code and error output of a fresh interpreter that looks for modules in ``paths`` first."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, paths)), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, *arguments]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return run.returncode, run.stderr


def project(folder: Path, name: str) -> None:
    """Install a project of someone else: a package of that name, and the record that pip leaves."""
    (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / name / "__init__.py").write_text("")
    record = folder / f"{name}-3.0.dist-info"
    record.mkdir()
    (record / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 3.0\n")
    (record / "RECORD").write_text(f"{name}/__init__.py,,\n{name}-3.0.dist-info/METADATA,,\n")


def copy_of_ours(folder: Path) -> Path:
    """The front door and empty packages, as pip would put them into one folder."""
    shutil.copytree(ROOT / "safewbc", folder / "safewbc", ignore=shutil.ignore_patterns("__pycache__"))
    for name in PACKAGES:
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text("")
    return folder


def test_nothing_is_wrong_here() -> None:
    assert HOME == ROOT
    assert installation_problem() is None


@pytest.mark.parametrize("name", PACKAGES)
@pytest.mark.parametrize("form", ["{}/__init__.py", "{}.py"])
def test_a_users_own_module_that_hides_ours_is_named(tmp_path: Path, name: str, form: str) -> None:
    file = tmp_path / form.format(name)
    file.parent.mkdir(exist_ok=True)
    file.write_text("")
    own = file.parent if file.stem == "__init__" else file
    code, told = call(["-m", "safewbc", "doctor"], tmp_path, ROOT)
    assert code == 2
    assert told == (
        f"safewbc: {own} hides our package {name!r} in {ROOT}: rename it, or start where it is neither in the current "
        "folder nor on PYTHONPATH\n"
    )


def test_an_import_from_the_front_door_tells_the_same(tmp_path: Path) -> None:
    (tmp_path / "controllers").mkdir()
    (tmp_path / "controllers" / "__init__.py").write_text("")
    code, told = call(["-c", "import safewbc as sw; sw.Supervisor"], tmp_path, ROOT)
    assert code == 1
    assert f"ImportError: {tmp_path / 'controllers'} hides our package 'controllers'" in told


def test_a_folder_without_a_package_in_it_hides_nothing(tmp_path: Path) -> None:
    (tmp_path / "controllers").mkdir()
    code, told = call(["-c", "import safewbc as sw; sw.ConfigError"], tmp_path, ROOT)
    assert (code, told) == (0, "")


def test_pypis_safety_before_a_checkout_is_to_be_uninstalled(tmp_path: Path) -> None:
    project(tmp_path, "safety")
    code, told = call(["-m", "safewbc", "doctor"], tmp_path, ROOT)
    assert code == 2
    assert told == (f"safewbc: PyPI's project 'safety' hides ours in {ROOT}: run `python -m pip uninstall safety`\n")


def test_pypis_safety_mixed_into_a_pip_install_asks_for_ours_again(tmp_path: Path) -> None:
    project(copy_of_ours(tmp_path), "safety")
    code, told = call(["-m", "safewbc", "doctor"], tmp_path)
    assert code == 2
    assert f"PyPI's project 'safety' has written its files into ours in {tmp_path / 'safety'}" in told
    uninstall, install = (
        told.index("pip uninstall safety"),
        told.index("pip install --force-reinstall --no-deps safewbc"),
    )
    assert uninstall < install


def test_a_checkout_that_lost_a_package_is_set_up_again(tmp_path: Path) -> None:
    home = copy_of_ours(tmp_path)
    (home / "pyproject.toml").write_text("")
    shutil.rmtree(home / "sims")
    # -S: no site-packages, where another installation of ours would be found
    code, told = call(["-S", "-m", "safewbc", "doctor"], home)
    assert code == 2
    assert f"package 'sims' is not in {home}: restore it" in told
    assert "make setup" in told
