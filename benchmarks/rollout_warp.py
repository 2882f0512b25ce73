"""The rollout in NVIDIA Warp's idiom: one launch over springs and one over vertices a step, gradients by a tape."""

from __future__ import annotations

import numpy as np
import warp as wp

wp.config.quiet = True


@wp.kernel
def pull(
    springs: wp.array2d(dtype=wp.int32),
    length: wp.array(dtype=wp.float32),
    sample: wp.array(dtype=wp.int32),
    theta: wp.array2d(dtype=wp.float32),
    position: wp.array(dtype=wp.vec3),
    force: wp.array(dtype=wp.vec3),
):
    """Add each spring's force to its two vertices."""
    spring = wp.tid()
    near, far = springs[spring, 0], springs[spring, 1]
    along = position[far] - position[near]
    now = wp.length(along)
    tension = theta[sample[near], 0] * (now - length[spring]) / now * along
    wp.atomic_add(force, near, tension)
    wp.atomic_add(force, far, -tension)


@wp.kernel
def move(
    sample: wp.array(dtype=wp.int32),
    theta: wp.array2d(dtype=wp.float32),
    free: wp.array(dtype=wp.float32),
    push: wp.array(dtype=wp.vec3),
    factor: wp.float32,
    step: wp.float32,
    mass: wp.float32,
    position: wp.array(dtype=wp.vec3),
    velocity: wp.array(dtype=wp.vec3),
    force: wp.array(dtype=wp.vec3),
    next_position: wp.array(dtype=wp.vec3),
    next_velocity: wp.array(dtype=wp.vec3),
):
    """Semi-implicit Euler with implicit damping."""
    vertex = wp.tid()
    own = sample[vertex]
    total = force[vertex] + factor * theta[own, 2] * push[vertex]
    value = free[vertex] * (velocity[vertex] + step / mass * total) / (1.0 + step / mass * theta[own, 1])
    next_velocity[vertex] = value
    next_position[vertex] = position[vertex] + step * value


@wp.kernel
def weigh(
    position: wp.array(dtype=wp.vec3),
    touched: wp.array(dtype=wp.int32),
    weights: wp.array(dtype=wp.vec3),
    loss: wp.array(dtype=wp.float32),
):
    """Add one step's share of Σ weights·position."""
    sample = wp.tid()
    wp.atomic_add(loss, 0, wp.dot(weights[sample], position[touched[sample]]))


class Warp:
    """Warp on the CPU, which runs on one thread."""

    def __init__(self, task, arrays: dict[str, np.ndarray]) -> None:
        """Move the batch to Warp and allocate every step's state, which the tape needs."""
        self.arrays, self.mechanics = arrays, task.mechanics
        count, steps = len(arrays["rest"]), task.mechanics.steps
        wp.set_device("cpu")
        self.theta = wp.array(arrays["theta"], dtype=wp.float32, requires_grad=True)
        self.springs = wp.array(arrays["springs"], dtype=wp.int32)
        self.length, self.free = (wp.array(arrays[name], dtype=wp.float32) for name in ("length", "free"))
        self.sample, self.touched = (wp.array(arrays[name], dtype=wp.int32) for name in ("sample", "touched"))
        self.push = wp.array(arrays["push"], dtype=wp.vec3)
        self.weights = [wp.array(row, dtype=wp.vec3) for row in arrays["weights"].transpose(1, 0, 2).copy()]
        self.positions = [wp.zeros(count, dtype=wp.vec3, requires_grad=True) for _ in range(steps + 1)]
        self.velocities = [wp.zeros(count, dtype=wp.vec3, requires_grad=True) for _ in range(steps + 1)]
        self.forces = [wp.zeros(count, dtype=wp.vec3, requires_grad=True) for _ in range(steps)]
        self.loss = wp.zeros(1, dtype=wp.float32, requires_grad=True)
        self.positions[0].assign(arrays["rest"])

    def roll(self) -> None:
        """All steps."""
        step, mass = self.mechanics.time_step, self.mechanics.mass
        for index, force in enumerate(self.forces):
            force.zero_()
            state = (self.positions[index], self.velocities[index], force)
            inputs = (self.springs, self.length, self.sample, self.theta, self.positions[index])
            wp.launch(pull, len(self.length), inputs=inputs, outputs=(force,))
            factor = 1.0 if index < self.mechanics.load_steps else 0.0
            inputs = (self.sample, self.theta, self.free, self.push, factor, step, mass, *state)
            after = (self.positions[index + 1], self.velocities[index + 1])
            wp.launch(move, len(self.free), inputs=inputs, outputs=after)

    def forward(self) -> np.ndarray:
        """Trajectories of the contact vertices, shape [B, T, 3]."""
        self.roll()
        touched = self.arrays["touched"]
        return np.stack([position.numpy()[touched] for position in self.positions[1:]], 1) - self.start()

    def start(self) -> np.ndarray:
        """Rest positions of the contact vertices, shape [B, 1, 3]."""
        return self.arrays["rest"][self.arrays["touched"]][:, None]

    def total(self) -> np.ndarray:
        """Gradient of Σ weights·trajectory by θ, shape [B, 3]."""
        self.loss.zero_()
        with wp.Tape() as tape:
            self.roll()
            for position, weights in zip(self.positions[1:], self.weights, strict=True):
                inputs = (position, self.touched, weights)
                wp.launch(weigh, len(self.arrays["touched"]), inputs=inputs, outputs=(self.loss,))
        tape.backward(self.loss)
        gradient = self.theta.grad.numpy().copy()
        tape.zero()
        return gradient
