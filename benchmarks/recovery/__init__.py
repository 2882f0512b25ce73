"""Recovery of θ on synthetic clips whose truth is known.

suites      the kinds of clips, and their seeds
trial       one clip against its truth, whatever moves its tissue
bounds      Cramér–Rao bounds of the depth-change sequence
scores      of presses, errors and coverage of many
grips       grips against their truth, and their table
"""
