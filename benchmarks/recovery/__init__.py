"""Recovery of θ on synthetic clips whose truth is known.

suites      the kinds of clips, and their seeds
trial       one clip against its truth
bounds      Cramér–Rao bounds of the depth-change sequence
scores      errors and coverage of many presses
grips       grips against their truth, and their table
"""
