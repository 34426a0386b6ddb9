"""Pages of documentation: what they link to is there, every page is on the site, the picture is as drawn last."""

import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
LINK = re.compile(r"\]\(([^)\s]+)\)")


def anchor(heading: str) -> str:
    """The anchor that GitHub and mkdocs make of a heading."""
    return re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", heading.replace("`", "").lower(), flags=re.ASCII).strip())


def anchors(page: Path) -> set[str]:
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    return {anchor(h) for h in re.findall(r"^#+ (.+)$", text, re.MULTILINE)}


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT / "docs").as_posix())
def test_links_of_a_page_lead_to_files_of_the_site_and_to_headings_in_them(page: Path) -> None:
    for link in LINK.findall(page.read_text(encoding="utf-8")):
        if "://" in link:
            continue
        file, _, heading = link.partition("#")
        target = (page.parent / file).resolve() if file else page
        assert target.is_file(), link
        assert target.is_relative_to(ROOT / "docs"), f"{link} is not on the site"
        assert not heading or heading in anchors(target), link


def test_every_page_is_in_the_navigation_of_the_site() -> None:
    named = set(re.findall(r"[\w/]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    assert named == {page.relative_to(ROOT / "docs").as_posix() for page in PAGES}


def test_every_package_has_a_page_of_the_reference() -> None:
    packages = {"robots", "wbc", "safety", "controllers", "sims", "experiments"}
    for name in packages:
        assert f"::: {name}\n" in (ROOT / "docs" / "api" / f"{name}.md").read_text(encoding="utf-8")


def test_the_picture_of_the_architecture_is_the_one_that_its_script_draws() -> None:
    script = runpy.run_path(str(ROOT / "tools" / "architecture.py"))
    assert script["TARGET"].read_text(encoding="utf-8") == script["picture"]()


def test_places_in_the_picture_are_there() -> None:
    script = runpy.run_path(str(ROOT / "tools" / "architecture.py"))
    places = [re.split(r"[,;] ", box.place) for box in script["BOXES"]]
    paths = {part for parts in places for part in parts if "/" in part}
    assert len(paths) > 10
    assert not [p for p in paths if not (ROOT / p).exists() and not (ROOT / f"{p}.py").exists()]


def test_the_page_of_the_front_door_tells_what_every_name_is() -> None:
    rows = [line for line in runpy.run_path(str(ROOT / "tools" / "front_door.py"))["tables"]() if "][" in line]
    assert len(rows) > 40
    assert not [row for row in rows if row.endswith("|  |")]
