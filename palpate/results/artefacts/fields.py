"""`fields.npz`: stiffness over the tissue in every frame, written frame by frame, so that memory doesn't grow."""

import zipfile

import numpy as np

from palpate.results import store
from palpate.results.artefacts.base import Artefact


class FieldFile(Artefact):
    """A file that `numpy.load` reads frame by frame.

    Of every run of contact `run_R/rest`, `run_R/faces` and, of a volume, `run_R/tetrahedra`, R its first frame's
    number; of every frame `frame_K/run` (R), `frame_K/positions`, `pixels`, `distance`, `shape`, `distance_log_sd`,
    `shape_log_sd`, `known` and `shape_known`, as `ParticleField` has them, reals as float32.
    """

    name = store.FIELDS

    def open(self) -> None:
        self._file = zipfile.ZipFile(self.path, "w", zipfile.ZIP_DEFLATED)
        self._run: int | None = None

    @classmethod
    def wanted(cls, options, estimator) -> bool:
        return estimator.tells_field

    def frame(self, estimate, image, labels) -> None:
        frame, field = estimate.frame, estimate.field
        if field is None:
            return
        if field.onset_frame != self._run:
            self._run = field.onset_frame
            self._add(f"run_{self._run}/rest", field.rest.astype(np.float32))
            self._add(f"run_{self._run}/faces", field.faces.astype(np.int32))
            if len(field.tetrahedra):
                self._add(f"run_{self._run}/tetrahedra", field.tetrahedra.astype(np.int32))
        self._add(f"frame_{frame}/run", np.array(field.onset_frame))
        distance, shape = field.distance, field.shape
        reals = {"positions": field.positions, "pixels": field.pixels, "distance": distance.value, "shape": shape.value}
        reals |= {"distance_log_sd": distance.log_sd, "shape_log_sd": shape.log_sd}
        for name, values in reals.items():
            self._add(f"frame_{frame}/{name}", values.astype(np.float32))
        self._add(f"frame_{frame}/known", distance.known)
        self._add(f"frame_{frame}/shape_known", shape.known)

    def close(self) -> None:
        self._file.close()

    def _add(self, name: str, values: np.ndarray) -> None:
        with self._file.open(f"{name}.npy", "w") as entry:
            np.lib.format.write_array(entry, values, allow_pickle=False)
