"""True motion against another integrator, a closed form, and the knobs that shape it."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.data.synthetic import truth as truths
from palpate.data.synthetic.integration import cut_window
from palpate.data.synthetic.scene import Scene, SceneError, draw_scene
from palpate.data.synthetic.settings import SceneSettings
from palpate.data.synthetic.truth import PressedMotion, draw_motion, draw_shape, draw_theta, simulate_motion
from palpate.physics.load import Press, PressShape, held
from palpate.physics.mechanics import Mechanics
from palpate.physics.msd.simulation import simulate

SMALL = SceneSettings(width=214, height=120, frames=24, onset_fraction=(0.15, 0.2))
THETA = np.array([0.5, 0.04, -0.05])
ONSET, RELEASE = 4, 12


@pytest.fixture(scope="module")
def scene() -> Scene:
    return draw_scene(SMALL, np.random.default_rng(1))


@pytest.fixture(scope="module")
def motion(scene: Scene) -> PressedMotion:
    return simulate_motion(scene, THETA, ONSET, RELEASE)


@pytest.fixture(scope="module")
def drawn(scene: Scene) -> list[PressedMotion]:
    """Two motions that begin at a frame."""
    return [draw_motion(scene, np.random.default_rng(seed)) for seed in range(2)]


def fitted(scene: Scene, time_step: float, seconds: float, load_seconds: float) -> np.ndarray:
    """Response of the fitted integrator, sampled like the truth."""
    mechanics = Mechanics(time_step=time_step, steps=round(seconds / time_step), load_steps=0)
    press = Press.at(scene.vertex, scene.direction, held(round(load_seconds / time_step), mechanics.steps))
    response = simulate(THETA, scene.mesh, press, mechanics, dtype=np.float64)
    every = round(truths.SAMPLE_STEP / time_step)
    return response[every - 1 :: every]


def test_the_fitted_integrator_converges_to_the_truth_at_first_order(scene: Scene, motion: PressedMotion) -> None:
    seconds = 0.45
    coarse, fine = (fitted(scene, step, seconds, motion.load_seconds) for step in (0.0025, 0.00125))
    truth = motion.response[: len(fine)]
    errors = [np.linalg.norm(response - truth, axis=1).max() for response in (coarse, fine)]
    assert errors[0] < 0.03 * motion.peak
    assert errors[0] / errors[1] == pytest.approx(2, rel=0.1)
    # The extrapolation removes the first-order error of the fitted scheme: what is left is of second order.
    assert np.linalg.norm(2 * fine - coarse - truth, axis=1).max() < 0.1 * errors[1]


def test_rest_force_and_samples_are_consistent(scene: Scene, motion: PressedMotion) -> None:
    assert not motion.contact[: ONSET + 1].any()
    assert not motion.field[: ONSET + 1].any()
    np.testing.assert_array_equal(motion.force != 0, (np.arange(24) >= ONSET) & (np.arange(24) < RELEASE))
    assert (motion.force[ONSET], motion.load_seconds) == (THETA[2], pytest.approx((RELEASE - ONSET) / 25))
    # 25 frames a second are 8 samples a frame.
    np.testing.assert_allclose(motion.contact[ONSET + 1 :], motion.response[7::8], atol=1e-12)
    where = np.flatnonzero(motion.moving == scene.vertex)[0]
    np.testing.assert_allclose(motion.field[:, where], motion.contact, atol=1e-7)
    # F < 0 presses against the normal, away from the camera.
    assert motion.contact[RELEASE] @ scene.direction < -0.9 * np.linalg.norm(motion.contact[RELEASE])
    assert motion.peak == pytest.approx(np.linalg.norm(motion.response, axis=1).max())


def test_first_instants_follow_the_closed_form(scene: Scene, motion: PressedMotion) -> None:
    # Before the springs answer, m x'' + k_d x' = F: x = F/k_d (t - tau (1 - exp(-t/tau))), tau = m/k_d. The six springs
    # take off a share of at most 6 k_s t^2 / (12 m), 0.6 % at 5 ms, and the curve of the sheet turns the rest aside.
    tau = SMALL.mass / THETA[1]
    time = truths.SAMPLE_STEP
    expected = THETA[2] / THETA[1] * (time - tau * (1 - math.exp(-time / tau)))
    assert motion.response[0] @ scene.direction == pytest.approx(expected, rel=0.01)


def test_a_wider_window_changes_nothing(scene: Scene, motion: PressedMotion, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("palpate.data.synthetic.integration._reach", lambda *_: 200)
    whole = simulate_motion(scene, THETA, ONSET, RELEASE)
    assert len(whole.moving) == len(scene.mesh.vertices)
    np.testing.assert_allclose(whole.response, motion.response, atol=3e-6)


def test_the_window_holds_its_border_and_the_rim_but_never_the_contact(scene: Scene) -> None:
    window = cut_window(scene, 6, None, PressShape())
    assert not window.held[window.contact]
    apart = np.abs(scene.mesh.pixels[window.vertices] - scene.mesh.pixels[scene.vertex]).max(axis=1)
    np.testing.assert_array_equal(window.held, (apart == 6) | scene.mesh.rim[window.vertices])
    np.testing.assert_allclose(np.linalg.norm(window.edges, axis=1), window.lengths)


def with_settings(scene: Scene, **changes) -> Scene:
    return dataclasses.replace(scene, settings=dataclasses.replace(scene.settings, **changes))


@pytest.mark.parametrize("late", [False, True])
def test_a_ramp_rises_from_its_start_to_the_force_at_release(scene: Scene, motion: PressedMotion, late: bool) -> None:
    """Late by a quarter of a frame, it has risen for three quarters in the first that it is seen in."""
    delays = {"delay": 0.01 * late, "release_delay": 0.01 * late}
    shape = PressShape(rise=(RELEASE - ONSET) / scene.settings.fps)
    ramp = simulate_motion(scene, THETA, ONSET, RELEASE, **delays, shape=shape)
    expected = np.zeros(24)
    expected[ONSET + late : RELEASE + late] = THETA[2] * (np.arange(8) + 0.75 * late) / 8
    np.testing.assert_allclose(ramp.force, expected)
    assert ramp.peak < motion.peak


def test_a_hold_rises_holds_and_falls(scene: Scene) -> None:
    third = 2 / scene.settings.fps
    hold = simulate_motion(scene, THETA, ONSET, ONSET + 6, shape=PressShape(rise=third, fall=third))
    np.testing.assert_allclose(hold.force[ONSET : ONSET + 7] / THETA[2], [0, 0.5, 1, 1, 1, 0.5, 0], atol=1e-9)


def test_a_patch_shares_the_force(scene: Scene, motion: PressedMotion) -> None:
    window = cut_window(scene, 12, None, PressShape(4.0))
    assert window.press.weights.sum() == pytest.approx(1)
    assert not window.held[window.press.vertices].any()
    pressed = simulate_motion(scene, THETA, ONSET, RELEASE, shape=PressShape(4.0))
    assert pressed.peak < 0.6 * motion.peak
    # Before any spring pulls, the vertex in the middle has its share of the acceleration.
    first, alone = (np.linalg.norm(item.response[0]) for item in (pressed, motion))
    assert first == pytest.approx(window.press.weights.max() * alone, rel=0.1)


def test_a_force_that_leans_moves_tissue_to_its_side(scene: Scene, motion: PressedMotion) -> None:
    """A sheet answers all directions in the same way, but for what holds its rim."""
    lean = 0.5
    leaning = simulate_motion(scene, THETA, ONSET, RELEASE, shape=PressShape(lean=(lean, 0.0)))
    straight, aside = motion.response[20], leaning.response[20]
    assert aside @ scene.direction == pytest.approx(straight @ scene.direction / np.hypot(1, lean), rel=0.05)
    right = np.array([1.0, 0.0, 0.0]) - scene.direction[0] * scene.direction
    assert aside @ right / (aside @ scene.direction) == pytest.approx(lean, rel=0.1)


def test_a_drawn_shape_lies_in_its_ranges(scene: Scene) -> None:
    ends = {"patch_radius": (2.0, 3.0), "force_tilt_deg": (5.0, 9.0), "rise": (0.1, 0.2), "fall": (0.3, 0.4)}
    settings = with_settings(scene, profile="hold", **ends).settings
    shapes = [draw_shape(settings, 0.5, np.random.default_rng(seed)) for seed in range(50)]
    tilts = np.degrees(np.arctan([np.hypot(*shape.lean) for shape in shapes]))
    found = np.column_stack([[(shape.radius, shape.rise, shape.fall) for shape in shapes], tilts])
    assert ((found >= [2, 0.05, 0.15, 5]) & (found <= [3, 0.1, 0.2, 9])).all()
    assert np.ptp([shape.radius for shape in shapes]) > 0.8
    assert min(shape.lean[0] for shape in shapes) < 0 < max(shape.lean[1] for shape in shapes)


@pytest.mark.parametrize("share", [0.25, 0.625, 1.0])
def test_a_late_force_is_the_same_motion_later(scene: Scene, motion: PressedMotion, share: float) -> None:
    delay = share / 25
    late = simulate_motion(scene, THETA, ONSET, RELEASE, delay=delay, release_delay=delay)
    assert late.delay == late.release_delay == delay
    assert late.load_seconds == pytest.approx(motion.load_seconds)
    np.testing.assert_allclose(late.response, motion.response[: len(late.response)], atol=1e-6)
    # The delays are whole samples of the response: 5 ms are an eighth of a frame interval.
    assert not late.contact[: ONSET + 1].any()
    late_samples = np.arange(1, 24 - ONSET) * 8 - round(8 * share)
    expected = np.concatenate((np.zeros((1, 3)), late.response))[late_samples]
    np.testing.assert_allclose(late.contact[ONSET + 1 :], expected, atol=1e-6)
    where = np.flatnonzero(late.moving == scene.vertex)[0]
    np.testing.assert_allclose(late.field[:, where], late.contact, atol=1e-7)
    # Frames show the force that acts just after them: it starts after the onset's and ends after the release's.
    np.testing.assert_array_equal(late.force != 0, (np.arange(24) > ONSET) & (np.arange(24) <= RELEASE))


@pytest.mark.slow
def test_the_delay_has_a_random_stream_of_its_own(scene: Scene, drawn: list[PressedMotion]) -> None:
    waiting = with_settings(scene, onset_delay=(0.0, 1.0))
    late = [draw_motion(waiting, np.random.default_rng(seed)) for seed in range(2)]
    for before, after in zip(drawn, late, strict=True):
        np.testing.assert_array_equal(after.theta, before.theta)
        assert (after.onset_frame, after.release_frame) == (before.onset_frame, before.release_frame)
        assert before.delay == 0 < after.delay < 1 / 25
    assert late[0].delay != late[1].delay
    both = with_settings(scene, onset_delay=(0.0, 1.0), release_delay=(0.0, 1.0))
    found = draw_motion(both, np.random.default_rng(0))
    assert found.delay == late[0].delay != found.release_delay


def test_a_late_release_holds_the_force_for_longer(scene: Scene, motion: PressedMotion) -> None:
    late = simulate_motion(scene, THETA, ONSET, RELEASE, release_delay=0.03)
    assert late.load_seconds == pytest.approx(motion.load_seconds + 0.03)
    np.testing.assert_allclose(late.contact[: RELEASE + 1], motion.contact[: RELEASE + 1], atol=1e-6)
    longer = simulate_motion(scene, THETA, ONSET, RELEASE + 1)  # before a frame that is held no difference shows
    held = round((RELEASE - ONSET) / 25 / 0.005) + 6
    np.testing.assert_allclose(late.response[:held], longer.response[:held], atol=1e-6)
    assert not np.allclose(late.response[held:], longer.response[held:], atol=1e-4)
    with pytest.raises(SceneError, match="ends before it starts"):
        simulate_motion(scene, THETA, ONSET, ONSET + 1, delay=0.04)


def test_a_delay_of_more_than_a_frame_is_refused() -> None:
    with pytest.raises(ValueError, match=r"scene.onset_delay is \(0.0, 1.5\); give 0 to 1\."):
        dataclasses.replace(SMALL, onset_delay=(0.0, 1.5))


def test_mismatch_knobs_change_the_truth(scene: Scene, motion: PressedMotion) -> None:
    stiffening = simulate_motion(with_settings(scene, nonlinearity=1.0), THETA, ONSET, RELEASE)
    assert stiffening.peak < 0.95 * motion.peak
    doubled = simulate_motion(scene, THETA, ONSET, RELEASE, np.full(scene.mesh.grid_shape, 2.0))
    stiff = simulate_motion(scene, THETA * [2, 1, 1], ONSET, RELEASE)
    np.testing.assert_allclose(doubled.response, stiff.response, atol=3e-6)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000), regime=st.sampled_from(["under-damped", "critical", "over-damped"]))
def test_theta_stays_in_its_box_and_regime(seed: int, regime: str) -> None:
    wanted = dataclasses.replace(SMALL, regime=regime)
    theta = draw_theta(wanted, np.random.default_rng(seed))
    assert ((theta >= [0.2, 0.01, -0.3]) & (theta <= [1, 0.3, -0.03])).all()
    assert truths.regime_of(truths.damping_ratio(*theta[:2], SMALL.mass)) == regime


def test_theta_is_log_uniform() -> None:
    generator = np.random.default_rng(0)
    draws = np.array([draw_theta(SMALL, generator) for _ in range(2000)])
    low, high = np.log([0.2, 0.01, 0.03]), np.log([1.0, 0.3, 0.3])
    share = (np.log(np.abs(draws)) - low) / (high - low)
    # Mean 1/2 and variance 1/12 of a uniform variable, within four standard errors of 2000 draws.
    np.testing.assert_allclose(share.mean(axis=0), 0.5, atol=4 * math.sqrt(1 / 12 / 2000))
    np.testing.assert_allclose(share.var(axis=0), 1 / 12, rtol=0.1)


def test_peaks_are_those_asked_for(drawn: list[PressedMotion]) -> None:
    assert all(0.01 <= motion.peak <= 0.06 * 1.001 for motion in drawn)


STIFF = {"stiffness": (1, 1), "damping": (0.3, 0.3), "force": (-0.03, -0.03), "press_seconds": (0.1, 0.1)}


@pytest.mark.parametrize(
    ("wish", "said"),
    [
        (STIFF | {"peak_displacement": (0.5, 1)}, r"scene\.peak_displacement"),
        ({"regime": "over-damped", "damping": (0.01, 0.011)}, "over-damped"),
        ({"frames": 9}, "released"),
    ],
)
def test_impossible_wishes_are_refused(scene: Scene, wish: dict, said: str) -> None:
    with pytest.raises(SceneError, match=said):
        draw_motion(with_settings(scene, **wish), np.random.default_rng(0))
