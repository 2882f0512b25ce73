"""Tracks of hundreds of tissue points over a clip, in pixels of its pictures.

following    a grid of points, from the first picture on
linking      links between places of two pictures, on which all others build
tissue       single tissue points, by the tissue around them, from picture to picture
flow         maps carried from frame to frame along dense optical flow
background   camera motion, and its subtraction
"""
