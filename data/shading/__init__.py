"""Brightness of tissue as an observation: light without the camera's response, and its change since rest.

light         from a picture to the logarithm of its light on a lattice, without instruments and highlights
registration  pictures of a camera that moves, in the view of an earlier one
sequence      that light around a contact over a run, and at rest, with its noise
"""
