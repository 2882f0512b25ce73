"""A camera that turns about its lens, as a hand does: all distances stay, the picture moves.

The finished picture is turned, with its noise and vignetting; in a real camera these stay in the picture.
"""

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from palpate.data.source.camera import back_project
from palpate.data.synthetic.scene import Scene


class CameraTurning:
    """Rotations of the camera over a clip, drawn for every axis; new parts of the picture mirror its edge."""

    def __init__(self, scene: Scene, generator: np.random.Generator) -> None:
        settings, camera = scene.settings, scene.camera
        self._camera, self._fps = camera, settings.fps
        self._size = np.radians(settings.turning_deg) * generator.uniform(0.3, 1, 3)
        self._rate = 2 * np.pi / generator.uniform(0.8, 2.5, 3)  # by periods [s]
        self._phase = generator.uniform(0, 2 * np.pi, 3)
        self._rays = back_project(np.ones((camera.height, camera.width)), camera)

    def rotation(self, index: int) -> np.ndarray:
        """Rotation from the camera's axes before any turning to those in a frame, shape [3, 3]."""
        angles = self._size * (np.sin(self._rate * index / self._fps + self._phase) - np.sin(self._phase))
        return Rotation.from_rotvec(angles).as_matrix()

    def turned(
        self, index: int, image: np.ndarray, labels: np.ndarray, depth: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Picture, labels and depth of a frame, each [H, W, …], as the turned camera has them."""
        turn, size = self.rotation(index), (self._camera.width, self._camera.height)
        warp = self._camera.matrix @ turn @ np.linalg.inv(self._camera.matrix)
        along = (depth * (self._rays @ turn[2])).astype(np.float32)
        image, labels, along = (
            cv2.warpPerspective(part, warp, size, flags=flags, borderMode=cv2.BORDER_REFLECT)
            for part, flags in ((image, cv2.INTER_LINEAR), (labels, cv2.INTER_NEAREST), (along, cv2.INTER_LINEAR))
        )
        return image, labels, along
