"""Brightness of tissue as an observation: light without the camera's response, and its change since rest.

light     from a picture to the logarithm of its light on a lattice, without instruments and highlights
sequence  that light around a contact over a run, beside that at rest, with its noise
"""
