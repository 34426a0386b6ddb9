"""Draws docs/images/architecture.svg: the parts and what flows between them.

    python tools/architecture.py

The picture is committed; a test says when it has to be drawn again.
"""

from dataclasses import dataclass
from html import escape
from pathlib import Path

TARGET = Path(__file__).resolve().parents[1] / "docs" / "images" / "architecture.svg"

WIDTH, HEIGHT = 1000, 640
INK, PAPER = "#22303c", "#ffffff"
ROBOT, WORLD, STUDY = "#e3eef7", "#eef4e4", "#f7eee0"
"""Fill of what runs on the robot, of what it is run in, and of what is made of runs."""

STYLE = f"""
text {{ font: 14px sans-serif; fill: {INK}; text-anchor: middle }}
.title {{ font-weight: 600 }} .small {{ font-size: 12px; fill: #51626f }}
.band {{ font-weight: 600; text-anchor: start }}
rect {{ stroke: {INK}; rx: 8 }} .frame {{ stroke-dasharray: 6 4 }}
path {{ stroke: {INK}; stroke-width: 1.6; fill: none; marker-end: url(#head) }}
"""

HEAD = (
    '<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    f'<path d="M0 0L8 4L0 8z" style="fill:{INK};stroke:none;marker-end:none"/></marker>'
)


@dataclass(frozen=True, slots=True)
class Band:
    """A coloured area with a title in its upper left corner."""

    title: str
    y: int
    height: int
    fill: str

    def svg(self) -> str:
        """Its elements."""
        frame = f'<rect class="frame" x="20" y="{self.y}" width="960" height="{self.height}" fill="{self.fill}"/>'
        return frame + f'<text class="band" x="36" y="{self.y + 22}">{escape(self.title)}</text>'


@dataclass(frozen=True, slots=True)
class Box:
    """A part, and where it is in the source."""

    title: str
    place: str
    x: int
    y: int
    width: int = 170

    def svg(self) -> str:
        """Its elements."""
        middle = self.x + self.width // 2
        return (
            f'<rect x="{self.x}" y="{self.y}" width="{self.width}" height="56" fill="{PAPER}"/>'
            f'<text class="title" x="{middle}" y="{self.y + 24}">{escape(self.title)}</text>'
            f'<text class="small" x="{middle}" y="{self.y + 43}">{escape(self.place)}</text>'
        )


@dataclass(frozen=True, slots=True)
class Flow:
    """What goes along an arrow; the label's place is given because lines cross."""

    path: str
    label: str = ""
    x: int = 0
    y: int = 0

    def svg(self) -> str:
        """Its elements."""
        return f'<path d="{self.path}"/><text class="small" x="{self.x}" y="{self.y}">{escape(self.label)}</text>'


BANDS = (
    Band("Agent: what runs on the robot, one call a tick", 16, 264, ROBOT),
    Band("A closed loop", 316, 116, WORLD),
    Band("Experiments", 468, 156, STUDY),
)

BOXES = (
    Box("gait, motions", "controllers/gaits, motions", 40, 60),
    Box("obstacle tracks", "safety/tracking", 515, 60),
    Box("supervisor", "controllers/supervisor", 765, 60),
    Box("tasks", "controllers/whole_body", 40, 180),
    Box("KinWBC", "wbc/kinwbc", 305, 180, 130),
    Box("safety filter", "safety/filters, barriers", 515, 180),
    Box("DynWBC", "wbc/dynwbc", 765, 180),
    Box("body, world", "sims/, or a robot; robots/ports", 40, 352, 220),
    Box("loop", "experiments/running", 415, 352),
    Box("observers", "recorder, progress, viewer", 750, 352, 200),
    Box("scenario", "experiments/scenarios", 40, 512),
    Box("run", "experiments/running", 260, 512, 150),
    Box("recording", "experiments/recording", 460, 512, 160),
    Box("study", "experiments/studies", 670, 512, 140),
    Box("report", "reports, metrics", 850, 512, 115),
)

FLOWS = (
    Flow("M125 116 L125 180", "references", 164, 152),
    Flow("M210 208 L305 208", "J, command", 257, 200),
    Flow("M435 208 L515 208", "v_des", 474, 200),
    Flow("M600 116 L600 180", "obstacles", 634, 152),
    Flow("M685 208 L765 208", "v_safe", 724, 200),
    Flow("M850 180 L850 116", "torques, set-points", 906, 152),
    Flow("M935 88 L964 88 L964 298 L550 298 L550 352", "motor command", 760, 293),
    Flow("M450 352 L450 280", "state, detections", 390, 302),
    Flow("M415 372 L260 372", "send, advance", 338, 365),
    Flow("M260 394 L415 394", "state, detections", 338, 412),
    Flow("M585 380 L750 380", "what happened", 667, 373),
    Flow("M335 512 L335 450 L480 450 L480 408", "agent, body, world", 408, 444),
    Flow("M850 408 L850 450 L540 450 L540 512", "channels", 690, 444),
    Flow("M210 540 L260 540"),
    Flow("M410 540 L460 540"),
    Flow("M620 540 L670 540", "many", 645, 532),
    Flow("M810 540 L850 540"),
    Flow("M540 568 L540 600 L905 600 L905 568", "one", 720, 594),
)


def picture() -> str:
    """The whole file."""
    parts = "\n".join(part.svg() for part in (*BANDS, *FLOWS, *BOXES))
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img">'
    paper = f'<rect x="0" y="0" width="{WIDTH}" height="{HEIGHT}" fill="{PAPER}" style="stroke:none;rx:0"/>'
    return f"{head}\n<style>{STYLE}</style>\n<defs>{HEAD}</defs>\n{paper}\n{parts}\n</svg>\n"


if __name__ == "__main__":
    TARGET.write_text(picture(), encoding="utf-8")
