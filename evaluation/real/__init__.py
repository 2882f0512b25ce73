"""Answers on real clips, judged by what was kept back from the fit.

pulled    tissue that an instrument holds and moves: how well the second half of the frames is predicted
predicted the same tissue ahead from a few frames, by the online estimator and by a sheet of one number
touching  contact in every frame, by whether tissue moves with the instrument
pressed   a dent of known force: how well the force of later frames is predicted
figures   pulls and presses as pictures; __main__: the door
"""
