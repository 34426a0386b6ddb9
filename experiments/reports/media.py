"""Pictures and films of finished runs: every body has the colour of its smallest barrier."""

import io
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from experiments.recording.gait_phases import stances, swings, walks, without_sway
from experiments.recording.recording import Recording, run_title, smallest_self_collision
from robots.description import RobotDescription
from robots.messages import Array, Indices
from safety.geometry.shapes import Obstacle
from sims.rendering import Camera, RobotRenderer, rendering_problem, video_problem, write_video
from sims.shapes import Shape

Picture = NDArray[np.uint8]

FAR = 0.05
"""Bodies with at least this distance [m] look calm."""
RAMP = np.array([(0.97, 0.50, 0.08), (0.95, 0.80, 0.30), (0.36, 0.70, 0.60), (0.22, 0.47, 0.82)])
"""Orange, yellow, green, blue: at contact, and at one, two and three thirds of ``FAR``."""
INSIDE = (0.88, 0.09, 0.11)
NEUTRAL = (0.58, 0.64, 0.72)

PLATE = (1.0, 1.0, 0.005)
"""Half sizes of what stands for a half-space [m]."""

WALKING_DISTANCE = 0.3
"""The camera follows a base that moves further than this [m]; otherwise it stands still."""

STANDING_FRAMES, WALKING_FRAMES = 4, 8
"""Number of pictures."""

FOOTPRINTS = 14
"""Number of footprints on the floor, the last ones."""

FOOTPRINT_HEIGHT = 0.002
"""[m]"""

CAPTION_HEIGHT = 64
CAPTION_BACK, CAPTION_INK, CAPTION_SAFE, CAPTION_UNSAFE = "#1f2933", "#f5f7fa", "#8fd3a8", "#ff8a80"


def barrier_colours(robot: RobotDescription, h_pairs: Array) -> Array:
    """Colour of each collision body by the smallest barrier among its pairs.

    The colours are those of :func:`distance_colours`. A body in no pair is grey; a barrier that is not a number counts
    as inside.

    Args:
        robot: the robot.
        h_pairs: shape (n_pairs,) barriers in the order of ``robot.self_collision_pairs`` [m].

    Returns:
        Shape (n_collisions, 3) red, green, blue in [0, 1], in the order of ``robot.collisions``.
    """
    index = {shape.name: i for i, shape in enumerate(robot.collisions)}
    smallest = np.full(len(index), np.inf)
    values = np.where(np.isnan(h_pairs), -np.inf, h_pairs)
    for pair, h in zip(robot.self_collision_pairs, values, strict=True):
        for name in pair:
            smallest[index[name]] = min(smallest[index[name]], h)
    colours = distance_colours(smallest)
    paired = {name for pair in robot.self_collision_pairs for name in pair}
    colours[[i for name, i in index.items() if name not in paired]] = NEUTRAL
    return colours


def distance_colours(distances: Array) -> Array:
    """Colours (n, 3) of bodies whose nearest neighbours are at ``distances`` (n,) [m].

    Blue from 5 cm on, over green and yellow to orange at contact, and red at once when inside.
    """
    stops = np.linspace(0.0, FAR, len(RAMP))
    colours = np.stack([np.interp(distances, stops, RAMP[:, k]) for k in range(3)], axis=1)
    colours[distances < 0] = INSIDE
    return colours


def obstacle_shapes(obstacles: Sequence[Obstacle]) -> list[Shape]:
    """What a picture shows of obstacles; a half-space is a thin plate of 2 m about its point."""
    return [_obstacle_shape(o) for o in obstacles]


def _obstacle_shape(obstacle: Obstacle) -> Shape:
    if obstacle.kind == "box":
        return Shape("box", tuple(obstacle.half_sizes.tolist()), obstacle.position, obstacle.rotation)
    length = float(np.linalg.norm(obstacle.direction))
    if obstacle.kind == "sphere" or (obstacle.kind == "capsule" and length == 0):
        return Shape("sphere", (obstacle.radius,), obstacle.position)
    along = rotation_to(obstacle.direction / length)
    if obstacle.kind == "capsule":
        middle = obstacle.position + 0.5 * obstacle.direction
        return Shape("capsule", (obstacle.radius, 0.5 * length), middle, along)
    return Shape("box", PLATE, obstacle.position - PLATE[2] * obstacle.direction, along)


def rotation_to(z: Array) -> Array:
    """A rotation (3, 3) whose z axis is the unit vector ``z`` (3,)."""
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(helper, z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def key_frames(result: Recording, n: int | None = None) -> list[tuple[float, bytes]]:
    """Pictures from the whole run: of feet in the air, where the plan lifts them, and of the smallest barrier.

    Args:
        result: the run.
        n: how many; ``None`` for 8 of a walk and 4 otherwise.

    Returns:
        (time [s], PNG) in the order of time; fewer than ``n`` for a run of fewer ticks, none where nothing can be
        rendered.
    """
    time = result.series["time"]
    if rendering_problem() is not None or not len(time):
        return []
    ticks = _key_ticks(result, n or (WALKING_FRAMES if walks(result.series) else STANDING_FRAMES))
    path = camera_path(result)
    with RobotRenderer(result.robot, 420, 480) as renderer:
        return [(float(time[k]), _png(_picture(renderer, result, k, path[k]))) for k in ticks]


def make_video(results: Sequence[Recording], path: Path, fps: float = 25.0) -> Path | None:
    """Film runs in real time, side by side, each with a caption; a run that ended early keeps its last picture.

    Args:
        results: at least one run.
        path: the MP4 file to write.
        fps: frames per second.

    Returns:
        ``path``, or ``None`` where no film can be made (:func:`sims.rendering.video_problem` says why).
    """
    shown = [r for r in results if len(r.series["time"])]
    if video_problem() is not None or not shown:
        return None
    write_video(path, _video_frames(shown, fps), fps)
    return path


def _video_frames(results: Sequence[Recording], fps: float) -> Iterator[Picture]:
    width = 640 if len(results) == 1 else 480
    end = max(float(r.series["time"][-1]) for r in results)
    with ExitStack() as stack:
        panels = [_Panel(r, stack.enter_context(RobotRenderer(r.robot, width, 480, smooth=False))) for r in results]
        for k in range(int(end * fps) + 1):
            yield np.hstack([panel.frame(k / fps) for panel in panels])


class _Panel:
    """One run's part of the film."""

    def __init__(self, result: Recording, renderer: RobotRenderer) -> None:
        self.result = result
        self.renderer = renderer
        self.path = camera_path(result)
        self.title = run_title(result)
        self.closest = np.minimum.accumulate(smallest_self_collision(result))

    def frame(self, t: float) -> Picture:
        """Picture at time ``t`` [s] under its caption, shape (height, width, 3)."""
        series = self.result.series
        tick = _last_before(series["time"], t)
        step = _last_before(series["step_time"], t)
        picture = _picture(self.renderer, self.result, tick, self.path[tick])
        over = t > series["time"][-1] + 0.1
        closest = float(self.closest[step]) if len(self.closest) else np.inf
        # on top, because a browser lays its player's controls over the lower edge
        return np.vstack([_caption(picture.shape[1], self.title, t, closest, over), picture])


def _caption(width: int, title: str, t: float, closest: float, over: bool) -> Picture:
    strip = Image.new("RGB", (width, CAPTION_HEIGHT), CAPTION_BACK)
    draw = ImageDraw.Draw(strip)
    large, small = ImageFont.load_default(22), ImageFont.load_default(17)
    draw.text((14, 7), title, font=large, fill=CAPTION_INK)
    draw.text((14, 36), "run ended" if over else f"t = {t:5.2f} s", font=small, fill=CAPTION_INK)
    if np.isfinite(closest):
        text = f"closest so far {1e3 * closest:+.1f} mm"
        colour = CAPTION_UNSAFE if closest < 0 else CAPTION_SAFE
        draw.text((width - 14, 36), text, font=small, fill=colour, anchor="ra")
    return np.asarray(strip)


def _last_before(times: NDArray[Any], t: float) -> int:
    """Index of the last of ``times`` not after ``t``; 0 when all are."""
    return max(0, int(np.searchsorted(times, t + 1e-9, side="right")) - 1)


def _key_ticks(result: Recording, n: int) -> list[int]:
    """``n`` ticks spread over the run, but for its ends moved to the middles of swings; one at the smallest barrier."""
    time = result.series["time"]
    ticks = np.linspace(0, len(time) - 1, n).round().astype(int)
    if len(time) > n > 1:
        middles = [(first + last) // 2 for first, last in swings(result.series)]
        ticks[1:-1] = _at_swings(ticks[1:-1], middles, int(ticks[1] - ticks[0]) // 2)
    h = smallest_self_collision(result)
    if len(h) and np.isfinite(h).any():
        worst = _last_before(time, float(result.series["step_time"][np.nanargmin(h)]))
        ticks[np.argmin(np.abs(ticks - worst))] = worst
    return sorted({int(k) for k in ticks})


def _at_swings(ticks: Indices, middles: Sequence[int], reach: int) -> Indices:
    """Ticks moved to the nearest of ``middles`` within ``reach``; each is taken once, the nearest pairs first."""
    ways = sorted((abs(int(tick) - m), k, m) for k, tick in enumerate(ticks) for m in middles)
    out, free, left = ticks.copy(), set(range(len(ticks))), set(middles)
    for way, k, middle in ways:
        if way <= reach and k in free and middle in left:
            out[k] = middle
            free.remove(k)
            left.remove(middle)
    return out


def camera_path(result: Recording) -> Array:
    """What the camera looks at, tick by tick, shape (T, 2) [m].

    It is the place of the base at the start, or where the robot walks, the base's path without its swaying.
    """
    base = result.series["q"][:, :2]
    if not len(base) or np.linalg.norm(np.ptp(base, axis=0)) <= WALKING_DISTANCE:
        return np.tile(base[:1], (len(base), 1))
    return without_sway(base, result.series["time"])


def footprints(result: Recording, tick: int) -> list[Shape]:
    """Thin plates where the soles have stood until a tick, of a run in which the plan lifts feet; the last ones."""
    if not swings(result.series):
        return []
    begun = [stance for stance in stances(result.series) if stance.first <= tick][-FOOTPRINTS:]
    now = result.series["sole_corners"][tick]
    return [_plate(result, s.foot, s.corners if s.last <= tick else now[s.foot]) for s in begun]


def _plate(result: Recording, foot: int, corners: Array) -> Shape:
    forward = np.append(corners[0] - corners[1], 0.0)
    forward /= np.linalg.norm(forward)
    rotation = np.column_stack([forward, np.cross([0.0, 0.0, 1.0], forward), [0.0, 0.0, 1.0]])
    sole, height = result.robot.soles[foot], 0.5 * FOOTPRINT_HEIGHT
    return Shape("box", (sole.half_length, sole.half_width, height), np.append(corners.mean(axis=0), height), rotation)


def _picture(renderer: RobotRenderer, result: Recording, tick: int, look_at: Array) -> Picture:
    series = result.series
    h_pairs = series["h_self_collision"]
    colours = None
    if len(h_pairs):
        colours = barrier_colours(result.robot, h_pairs[_last_before(series["step_time"], series["time"][tick])])
    targets = [series[name][tick] for name in ("left_hand_ref", "right_hand_ref") if name in series]
    return renderer.image(
        series["q"][tick],
        colours,
        Camera(look_at=(float(look_at[0]), float(look_at[1]))),
        np.array(targets) if targets else None,
        series["obstacle"][tick : tick + 1] if "obstacle" in series else None,
        footprints(result, tick),
    )


def _png(picture: Picture) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()
