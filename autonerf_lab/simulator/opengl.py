"""OpenGL renderer of a scene (pyrender), an independent reference for the simulator's images.

pyrender is no longer maintained; this module contains the workarounds that it needs without a display.
"""

import os
from typing import Any

import numpy as np

from autonerf_lab.errors import AutoNerfError
from autonerf_lab.geometry import Intrinsics
from autonerf_lab.scenes.scene import Scene

_NEAR, _FAR = 0.02, 100.0  # metres


class GLRenderer:
    """Renderer of colour and depth with OpenGL. Close it after use, or use it in a ``with`` statement.

    Args:
        scene: Scene to render.
        intrinsics: Intrinsics of the camera.

    Raises:
        AutoNerfError: pyrender or the OpenGL libraries of the system are missing.
    """

    def __init__(self, scene: Scene, intrinsics: Intrinsics) -> None:
        pyrender = _import_pyrender()
        self._pyrender = pyrender
        texture = pyrender.Texture(source=scene.texture, source_channels="RGB")
        texture.sampler = pyrender.Sampler(magFilter=9729, minFilter=9729)  # GL_LINEAR, no mipmaps
        material = pyrender.MetallicRoughnessMaterial(baseColorTexture=texture, doubleSided=True, metallicFactor=0.0)
        uv = scene.uv.reshape(-1, 2)
        primitive = pyrender.Primitive(
            positions=scene.vertices[scene.faces.reshape(-1)].astype(np.float32),
            texcoord_0=np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1).astype(np.float32),  # in OpenGL v points up
            material=material,
            mode=4,  # GL_TRIANGLES
        )
        self._scene = pyrender.Scene(bg_color=(0, 0, 0, 0))
        self._scene.add(pyrender.Mesh([primitive]))
        k = intrinsics
        self._camera = self._scene.add(pyrender.IntrinsicsCamera(k.fl_x, k.fl_y, k.cx, k.cy, _NEAR, _FAR))
        try:
            self._renderer: Any = pyrender.OffscreenRenderer(k.width, k.height)
        except Exception as error:  # PyOpenGL and pyglet raise many unrelated types
            raise AutoNerfError(
                f"OpenGL cannot be initialised ({error}); on Debian: apt-get install libegl1 libgl1"
            ) from error

    def render(self, c2w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Render the image at a pose.

        Args:
            c2w: (4, 4) camera-to-world pose, OpenGL axes, metres.

        Returns:
            rgb (H, W, 3) uint8 with one sample per pixel, and depth (H, W) float32 along the optical axis, metres,
            0 = no surface.
        """
        self._scene.set_pose(self._camera, np.asarray(c2w, dtype=np.float64))
        color, depth = self._renderer.render(self._scene, flags=self._pyrender.RenderFlags.FLAT)
        return np.array(color[..., :3]), np.array(depth)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.delete()

    def __enter__(self) -> "GLRenderer":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _import_pyrender() -> Any:
    """Import pyrender with the settings and patches that it needs."""
    os.environ.setdefault("PYOPENGL_PLATFORM", "egl")  # read by PyOpenGL when it is imported
    os.environ.setdefault("PYGLET_HEADLESS", "1")
    if not hasattr(np, "infty"):
        setattr(np, "infty", np.inf)  # noqa: B010 - removed in NumPy 2, but used by pyrender
    try:
        import pyrender
    except Exception as error:  # ImportError, or errors of PyOpenGL without its libraries
        raise AutoNerfError(
            f"pyrender cannot be imported ({error}); pip install 'autonerf-lab[gl]', and on Debian:"
            " apt-get install libegl1 libgl1"
        ) from error
    # Disable multisampling: pyrender would return the depth of a sample up to half a pixel beside the pixel centre.
    storage = pyrender.renderer.glRenderbufferStorageMultisample
    if getattr(storage, "__name__", "") != "_one_sample":

        def _one_sample(target: int, _: int, *size: int) -> None:
            storage(target, 0, *size)

        pyrender.renderer.glRenderbufferStorageMultisample = _one_sample
    return pyrender
