"""What the parts of the trained system are worth, each on synthetic clips with known truth.

terms        generators trained without one term of the loss, the picture or the carried map
next_depth   the picture some frames ahead, by physics and by a trained generator
watched      a synthetic clip and its noise-free truth; generated: what a trained generator makes of it
"""
