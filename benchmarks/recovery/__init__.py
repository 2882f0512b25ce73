"""How well θ is recovered on synthetic clips whose truth is known.

suites      the kinds of clips, and their seeds
estimators  how each rival is opened, and the constant that ignores its input
trial       one clip against its truth, whatever moves its tissue; grip_truth: a grip against it
bounds      Cramér–Rao bounds of the contact point and of the depth-change sequence
scores      of presses, errors and coverage of many
grips       the table of clips whose tool grips tissue
"""
