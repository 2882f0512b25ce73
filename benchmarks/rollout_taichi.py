"""The rollout in Taichi's idiom: fields that hold every step, one kernel a step, gradients by `ti.ad.Tape`."""

import numpy as np  # no `from __future__ import annotations`: Taichi reads the annotations of its kernels
import taichi as ti


@ti.data_oriented
class Taichi:
    """Taichi on the CPU."""

    def __init__(self, task, arrays: dict[str, np.ndarray], threads: int) -> None:
        """Start Taichi and fill its fields."""
        ti.init(arch=ti.cpu, cpu_max_num_threads=threads, offline_cache=False, log_level=ti.ERROR)
        self.arrays, mechanics = arrays, task.mechanics
        self.steps, self.load_steps = mechanics.steps, mechanics.load_steps
        self.step, self.mass = mechanics.time_step, mechanics.mass
        count, batch = len(arrays["rest"]), len(arrays["theta"])
        self.theta = ti.field(ti.f32, shape=(batch, 3), needs_grad=True)
        self.springs = ti.Vector.field(2, ti.i32, shape=len(arrays["springs"]))
        self.length = ti.field(ti.f32, shape=len(arrays["springs"]))
        self.sample, self.free = ti.field(ti.i32, shape=count), ti.field(ti.f32, shape=count)
        self.push = ti.Vector.field(3, ti.f32, shape=count)
        self.touched = ti.field(ti.i32, shape=batch)
        self.weights = ti.Vector.field(3, ti.f32, shape=(batch, self.steps))
        self.position = ti.Vector.field(3, ti.f32, shape=(self.steps + 1, count), needs_grad=True)
        self.velocity = ti.Vector.field(3, ti.f32, shape=(self.steps + 1, count), needs_grad=True)
        self.force = ti.Vector.field(3, ti.f32, shape=(self.steps, count), needs_grad=True)
        self.seen = ti.Vector.field(3, ti.f32, shape=(batch, self.steps))
        self.loss = ti.field(ti.f32, shape=(), needs_grad=True)
        for name in ("theta", "springs", "length", "sample", "free", "push", "touched", "weights"):
            getattr(self, name).from_numpy(arrays[name])
        self.begin(arrays["rest"])

    @ti.kernel
    def begin(self, rest: ti.types.ndarray()):
        """Put the vertices to rest."""
        for vertex in range(rest.shape[0]):
            for axis in ti.static(range(3)):
                self.position[0, vertex][axis] = rest[vertex, axis]

    @ti.kernel
    def clear(self):
        """Forget the forces of the last rollout."""
        for index in ti.grouped(self.force):
            self.force[index] = ti.Vector([0.0, 0.0, 0.0])

    @ti.kernel
    def pull(self, index: ti.i32):
        """Add each spring's force to its two vertices."""
        for spring in self.springs:
            near, far = self.springs[spring][0], self.springs[spring][1]
            along = self.position[index, far] - self.position[index, near]
            now = along.norm()
            tension = self.theta[self.sample[near], 0] * (now - self.length[spring]) / now * along
            self.force[index, near] += tension
            self.force[index, far] += -tension

    @ti.kernel
    def move(self, index: ti.i32, factor: ti.f32):
        """Semi-implicit Euler with implicit damping."""
        for vertex in self.free:
            own = self.sample[vertex]
            kick = self.step / self.mass
            total = self.force[index, vertex] + factor * self.theta[own, 2] * self.push[vertex]
            keep = self.free[vertex] / (1.0 + kick * self.theta[own, 1])
            self.velocity[index + 1, vertex] = keep * (self.velocity[index, vertex] + kick * total)
            self.position[index + 1, vertex] = (
                self.position[index, vertex] + self.step * self.velocity[index + 1, vertex]
            )

    @ti.kernel
    def weigh(self):
        """Σ weights·position."""
        for sample, index in self.weights:
            self.loss[None] += self.weights[sample, index].dot(self.position[index + 1, self.touched[sample]])

    @ti.kernel
    def look(self):
        """Pick the contact vertices out."""
        for sample, index in self.seen:
            self.seen[sample, index] = self.position[index + 1, self.touched[sample]]

    def roll(self) -> None:
        """All steps."""
        for index in range(self.steps):
            self.pull(index)
            self.move(index, 1.0 if index < self.load_steps else 0.0)

    def forward(self) -> np.ndarray:
        """Trajectories of the contact vertices, shape [B, T, 3]."""
        self.clear()
        self.roll()
        self.look()
        return self.seen.to_numpy() - self.arrays["rest"][self.arrays["touched"]][:, None]

    def total(self) -> np.ndarray:
        """Gradient of Σ weights·trajectory by θ, shape [B, 3]."""
        self.clear()
        with ti.ad.Tape(self.loss):
            self.roll()
            self.weigh()
        return self.theta.grad.to_numpy()
