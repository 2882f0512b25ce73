"""The table's rows: every kind of observation looks where it says, and more observations never tell less."""

from __future__ import annotations

from palpate.benchmarks.observation_bounds import FINE_MECHANICS, FRAME, limits, observations
from palpate.data.contact.depth_sequence import REACH
from palpate.data.synthetic.contacts import draw_contacts
from palpate.data.synthetic.settings import SceneSettings


def test_more_observations_never_tell_less() -> None:
    contact = draw_contacts(SceneSettings(width=214, height=120, regime="critical"), 3, 1, 0.005)[0]
    kinds = observations(contact)
    assert kinds["final"].steps.tolist() == [FINE_MECHANICS.steps - 1]
    assert kinds["contact, K = 4"].steps.tolist() == [FRAME - 1, 2 * FRAME - 1, 3 * FRAME - 1, 4 * FRAME - 1]
    found = {name: limits(contact, seen) for name, seen in kinds.items()}
    assert (found["final"] > 100).all()  # one vector, almost along one direction, for three unknowns
    whole = f"dent to {REACH} px, K = 25"
    for more, less in (
        ("contact, K = 25", "contact, K = 4"),
        ("contact, K = 25", "contact, under the tool"),
        ("contact, K = 25", "contact, K = 25, instants unknown"),
        ("dent to 4 px, K = 25", "dent to 2 px, K = 25"),
        (whole, "dent to 4 px, K = 25"),
        (f"dent to {REACH + 8} px, K = 25", whole),
        (whole, "dent, under the tool"),
        (whole, f"{whole}, instants unknown"),
    ):
        assert (found[more] <= found[less] * (1 + 1e-6)).all(), (more, less)
    # Beyond what is compared hardly anything is left to know.
    assert (found[whole] < 1.03 * found[f"dent to {REACH + 8} px, K = 25"]).all()
    assert (found[whole] < 0.8 * found["contact, K = 25"]).all()
