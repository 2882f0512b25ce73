"""How well θ is recovered on synthetic clips whose truth is known.

suites      the kinds of clips, and their seeds
trial       one clip against its truth, whatever moves its tissue
bounds      what a contact, and its whole dent, could show at best
scores      of presses, errors and coverage of many
grips       grips against their truth, and their table
"""
