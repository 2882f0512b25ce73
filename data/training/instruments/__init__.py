"""Pictures of instruments with their outlines, drawn on the fly or real.

drawing     instruments as shaded solids
scenery     backgrounds without instruments; highlights, rims and lettering over a picture
composites  instruments on backgrounds as a camera shows them; the pictures with labels that training reads
datamodule  batches of them
"""
