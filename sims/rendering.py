"""Pictures of a robot in a configuration: its collision bodies on a plain skeleton, drawn by MuJoCo off screen."""

import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import imageio_ffmpeg
import mujoco
import numpy as np
from numpy.typing import NDArray

from robots.description import RobotDescription
from robots.errors import ConfigError, SafeWbcError
from robots.messages import Array
from robots.mujoco_spec import COLLISION_GROUP, build_mujoco_spec
from sims.shapes import Shape

Image = NDArray[np.uint8]

DEBIAN_PACKAGES = "libegl1 libgl1-mesa-dri libopengl0"
SKELETON_RGBA = (0.63, 0.65, 0.69, 1.0)
MARKER_RGBA = np.array([0.16, 0.68, 0.38, 1.0], dtype=np.float32)
OBSTACLE_RGBA = np.array([0.42, 0.2, 0.55, 0.9], dtype=np.float32)
SHAPE_RGBA = np.array([0.5, 0.53, 0.58, 0.45], dtype=np.float32)
"""Grey, and seen through: what it hides is what matters."""
GEOM_TYPES = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE.value,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE.value,
    "box": mujoco.mjtGeom.mjGEOM_BOX.value,
}
TILE = 0.25
"""Edge of the floor's tiles [m]; one corner of them lies in the world's origin."""
SHORTEST_BONE = 0.02
"""Joint offsets shorter than this [m] get no bone: it would be hidden in its neighbours."""


class RenderingError(SafeWbcError, RuntimeError):
    """No image can be made on this machine; the message says why and what helps."""


@dataclass(frozen=True, slots=True)
class Camera:
    """Where the picture is taken from.

    Attributes:
        azimuth: direction of view about the vertical [deg]; 0 looks along x, so 215 looks at a robot that faces x
            from its front left.
        elevation: direction of view over the horizon [deg]; negative looks down.
        distance: from the camera to the point it looks at, in heights of the robot.
        look_at: point (x, y) on the ground that stays in the centre [m]; ``None`` follows the base.
        height: of the point in the centre over the ground, in heights of the robot.
    """

    azimuth: float = 213.0
    elevation: float = -9.0
    distance: float = 1.55
    look_at: tuple[float, float] | None = None
    height: float = 0.47


@cache
def rendering_problem() -> str | None:
    """Why no image can be rendered on this machine, with what to install; ``None`` when it works."""
    try:
        context = _open_gl_context(16, 16)
        context.make_current()
        # some back ends open without a display, and say only here that there is nothing to draw on
        mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), mujoco.mjtFontScale.mjFONTSCALE_100.value).free()
    except RenderingError as error:
        return str(error)
    except Exception as error:  # the GL bindings raise whatever their missing library makes them raise
        reason = f"{type(error).__name__}: {error}"
        return f"no off-screen OpenGL ({reason}). On Debian or Ubuntu: apt install {DEBIAN_PACKAGES}"
    context.free()
    return None


@cache
def video_problem() -> str | None:
    """Why no film can be made on this machine, with what to install; ``None`` when it works."""
    try:
        imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        return f"no ffmpeg ({error}). Install it with: pip install imageio-ffmpeg"
    return rendering_problem()


def _open_gl_context(width: int, height: int) -> Any:
    """A GL context that needs no window.

    ``mujoco.Renderer`` fixes its back end when mujoco is first imported, by whoever does that; a machine without a
    display then gets none. Asking the back end itself works whatever was imported before.
    """
    chosen = os.environ.get("MUJOCO_GL", "").strip().lower()
    if chosen in {"disable", "disabled", "off", "false", "0"}:
        raise RenderingError(f"rendering is switched off: the environment says MUJOCO_GL={chosen}")
    if platform.system() != "Linux":
        return mujoco.GLContext(width, height)
    backend = {"": "egl", "egl": "egl", "osmesa": "osmesa"}.get(chosen, "glfw")
    return import_module(f"mujoco.{backend}").GLContext(width, height)


class RobotRenderer:
    """Draws a robot in given configurations. A context manager: it holds an OpenGL context.

    No physics runs: only the placement of the bodies is computed. Shadows and reflections are off, since software
    OpenGL spends nearly all of its time on them.
    """

    def __init__(self, robot: RobotDescription, width: int = 640, height: int = 480, smooth: bool = True) -> None:
        """Build the scene and open the OpenGL context.

        Args:
            robot: a checked description.
            width: of the images [pixels].
            height: of the images [pixels].
            smooth: smooth the edges; without, software OpenGL is twice as fast.

        Raises:
            RenderingError: there is no OpenGL here.
        """
        if (problem := rendering_problem()) is not None:
            raise RenderingError(problem)
        self.robot = robot
        self._model = _build_scene_model(robot, width, height, smooth)
        self._data = mujoco.MjData(self._model)
        self._collision_geoms = np.array(
            [self._model.geom(f"{shape.name}_collision").id for shape in robot.collisions], dtype=int
        )
        self._own_colours = self._model.geom_rgba[self._collision_geoms, :3].copy()
        self._height = _standing_height(self._model, self._data, robot, self._collision_geoms)
        self._gl = _open_gl_context(width, height)
        self._gl.make_current()
        self._scene = _plain_scene(self._model)
        self._options = mujoco.MjvOption()
        self._options.geomgroup[COLLISION_GROUP] = 1
        self._context = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100.value)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._context)
        self._rect = mujoco.MjrRect(0, 0, width, height)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the OpenGL context back; the renderer cannot be used afterwards."""
        if self._gl is not None:
            self._gl.make_current()
            self._context.free()
            self._gl.free()
            self._gl = None

    def image(
        self,
        q: Array,
        colours: Array | None = None,
        camera: Camera | None = None,
        markers: Array | None = None,
        obstacles: Array | None = None,
        shapes: Sequence[Shape] = (),
    ) -> Image:
        """Draw the robot.

        Args:
            q: shape (nq,) configuration, pinocchio's order.
            colours: shape (n_collisions, 3) red, green, blue in [0, 1], in the order of ``robot.collisions``;
                ``None`` for the plain blue.
            camera: where from; ``None`` for the front left, following the base.
            markers: shape (n, 3) points in the world that get a small green ball [m].
            obstacles: shape (n, 4) spheres in the world, centre and radius [m].
            shapes: further things in the world, drawn in translucent grey.

        Returns:
            Shape (height, width, 3), a new array.

        Raises:
            ConfigError: ``q`` or ``colours`` has another shape, or there are too many markers and shapes.
            RenderingError: the renderer is closed.
        """
        if self._gl is None:
            raise RenderingError("this renderer was closed")
        self._place(q)
        self._paint(colours)
        view, every = self._mujoco_camera(camera or Camera(), q), mujoco.mjtCatBit.mjCAT_ALL.value
        # the endless floor is laid out about the scene's camera, which is the last picture's until it is updated
        mujoco.mjv_updateCamera(self._model, self._data, view, self._scene)
        mujoco.mjv_updateScene(self._model, self._data, self._options, None, view, every, self._scene)
        points = np.empty((0, 3)) if markers is None else markers
        self._add_spheres(np.column_stack([points, np.full(len(points), 0.016 * self._height)]), MARKER_RGBA)
        self._add_spheres(np.empty((0, 4)) if obstacles is None else obstacles, OBSTACLE_RGBA)
        self._add_shapes(shapes, SHAPE_RGBA)
        self._gl.make_current()
        mujoco.mjr_render(self._rect, self._scene, self._context)
        pixels = np.empty((self._rect.height, self._rect.width, 3), dtype=np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._rect, self._context)
        return np.ascontiguousarray(pixels[::-1])  # OpenGL's first row is the lowest

    def _place(self, q: Array) -> None:
        if q.shape != (self._model.nq,):
            raise ConfigError("q", q.shape, f"an array of shape ({self._model.nq},)")
        self._data.qpos[:3] = q[:3]
        self._data.qpos[3:7] = q[[6, 3, 4, 5]]
        self._data.qpos[7:] = q[7:]
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)

    def _paint(self, colours: Array | None) -> None:
        if colours is None:
            colours = self._own_colours
        if colours.shape != self._own_colours.shape:
            raise ConfigError("colours", colours.shape, f"an array of shape {self._own_colours.shape}")
        self._model.geom_rgba[self._collision_geoms, :3] = colours

    def _mujoco_camera(self, view: Camera, q: Array) -> mujoco.MjvCamera:
        camera = mujoco.MjvCamera()
        camera.type = mujoco.mjtCamera.mjCAMERA_FREE
        camera.azimuth, camera.elevation = view.azimuth, view.elevation
        camera.distance = view.distance * self._height
        x, y = (q[0], q[1]) if view.look_at is None else view.look_at
        camera.lookat[:] = x, y, view.height * self._height
        return camera

    def _add_spheres(self, spheres: Array, rgba: NDArray[np.float32]) -> None:
        self._add_shapes([Shape("sphere", (float(s[3]),), s[:3]) for s in spheres], rgba)

    def _add_shapes(self, shapes: Sequence[Shape], rgba: NDArray[np.float32]) -> None:
        if len(shapes) > (room := self._scene.maxgeom - self._scene.ngeom):
            raise ConfigError("markers and shapes", len(shapes), f"at most {room}")
        for shape in shapes:
            geom = self._scene.geoms[self._scene.ngeom]
            # a sphere's radius goes for all three axes
            size = np.resize(shape.size, 3) if shape.kind != "capsule" else np.array([*shape.size, 0.0])
            mujoco.mjv_initGeom(geom, GEOM_TYPES[shape.kind], size, shape.center, shape.rotation.ravel(), rgba)
            self._scene.ngeom += 1


def write_video(path: Path, frames: Iterable[Image], fps: float) -> None:
    """Write images as an H.264 film (MP4, yuv420p), which every browser plays.

    Args:
        path: the file to write.
        frames: images of one shape (height, width, 3); an odd size loses its last row or column.
        fps: frames per second.

    Raises:
        ConfigError: there is no frame.
    """
    iterator = iter(frames)
    if (first := next(iterator, None)) is None:
        raise ConfigError("frames", [], "at least one image")
    height, width = (2 * (n // 2) for n in first.shape[:2])
    writer = imageio_ffmpeg.write_frames(
        str(path), (width, height), fps=fps, codec="libx264", quality=None, macro_block_size=2,
        output_params=["-crf", "23", "-preset", "veryfast", "-movflags", "+faststart"],
    )  # fmt: skip
    writer.send(None)
    try:
        writer.send(np.ascontiguousarray(first[:height, :width]))
        for frame in iterator:
            writer.send(np.ascontiguousarray(frame[:height, :width]))
    finally:
        writer.close()


def _standing_height(
    model: mujoco.MjModel, data: mujoco.MjData, robot: RobotDescription, collision_geoms: NDArray[np.int_]
) -> float:
    """Height of the highest collision body over the ground, standing [m]; the base's height where there is none."""
    posture = robot.posture("standing")
    data.qpos[:7] = 0.0, 0.0, posture.base_height, 1.0, 0.0, 0.0, 0.0
    data.qpos[7:] = posture.joints
    mujoco.mj_kinematics(model, data)
    tops = data.geom_xpos[collision_geoms, 2] + model.geom_rbound[collision_geoms]
    return float(max([posture.base_height, *tops]))


def _plain_scene(model: mujoco.MjModel) -> mujoco.MjvScene:
    scene = mujoco.MjvScene(model, maxgeom=model.ngeom + 50)
    scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
    scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
    return scene


def _build_scene_model(robot: RobotDescription, width: int, height: int, smooth: bool) -> mujoco.MjModel:
    """The robot's own spec with bones, lights, a pale floor and sky, and a buffer of the image's size."""
    spec = build_mujoco_spec(robot)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.quality.offsamples = 4 if smooth else 0
    spec.visual.quality.numslices, spec.visual.quality.numstacks = 24, 12
    _add_bones(spec, robot)
    _add_floor_and_sky(spec)
    _add_lights(spec)
    return spec.compile()


def _add_bones(spec: mujoco.MjSpec, robot: RobotDescription) -> None:
    """Grey capsules from each body's origin to those of its children: many bodies have no collision body."""
    radius = 0.048 * robot.posture("standing").base_height
    soles = {robot.frame(sole.frame).body: robot.frame(sole.frame).xyz for sole in robot.soles}
    for body in robot.bodies:
        ends = [b.joint.xyz for b in robot.bodies if b.parent == body.name and b.joint is not None]
        if body.name in soles:
            ends.append(0.5 * soles[body.name])
        for end in ends:
            if np.linalg.norm(end) < SHORTEST_BONE:
                continue
            bone = spec.body(body.name).add_geom()
            bone.type = mujoco.mjtGeom.mjGEOM_CAPSULE
            bone.fromto = [0.0, 0.0, 0.0, *end]
            bone.size = [radius, 0.0, 0.0]
            bone.contype, bone.conaffinity, bone.mass = 0, 0, 0.0
            bone.rgba = list(SKELETON_RGBA)


def _add_floor_and_sky(spec: mujoco.MjSpec) -> None:
    sky = spec.add_texture()
    sky.name, sky.type = "sky", mujoco.mjtTexture.mjTEXTURE_SKYBOX
    sky.builtin = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    sky.rgb1, sky.rgb2 = [0.80, 0.86, 0.93], [0.97, 0.98, 0.99]
    sky.width, sky.height = 64, 64
    tiles = spec.add_texture()
    tiles.name, tiles.type = "tiles", mujoco.mjtTexture.mjTEXTURE_2D
    tiles.builtin, tiles.mark = mujoco.mjtBuiltin.mjBUILTIN_CHECKER, mujoco.mjtMark.mjMARK_EDGE
    tiles.rgb1, tiles.rgb2, tiles.markrgb = [0.95, 0.96, 0.98], [0.84, 0.865, 0.90], [0.70, 0.74, 0.80]
    tiles.width, tiles.height = 512, 512
    floor = spec.add_material()
    floor.name = "floor"
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    # two tiles each way in the texture, which is counted in half metres: sizes of geoms are halves
    floor.texrepeat, floor.texuniform = [1.0 / TILE, 1.0 / TILE], True
    floor.specular, floor.shininess = 0.0, 0.0
    for geom in spec.geoms:
        if geom.name == "floor":
            geom.material = "floor"
            geom.rgba = [1.0, 1.0, 1.0, 1.0]


def _add_lights(spec: mujoco.MjSpec) -> None:
    spec.visual.headlight.ambient = [0.42, 0.42, 0.42]
    spec.visual.headlight.diffuse = [0.28, 0.28, 0.28]
    spec.visual.headlight.specular = [0.05, 0.05, 0.05]
    for direction, strength in (((-0.5, 0.35, -0.8), 0.42), ((0.1, -0.7, -0.5), 0.14)):
        light = spec.worldbody.add_light()
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        light.dir = list(direction)
        light.diffuse = [strength] * 3
        light.specular = [0.12, 0.12, 0.12]
        light.castshadow = False
