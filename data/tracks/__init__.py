"""Hundreds of tissue points followed over a clip, in pixels of its pictures.

following    a grid of points, from the first picture on
linking      where the places of one picture are in another one: all others follow by it
tissue       single tissue points, by what surrounds them, from picture to picture
flow         maps carried from frame to frame along dense optical flow
background   the camera's own motion taken off
"""
