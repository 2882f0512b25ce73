"""Pages that show results in a browser, without a network: one of a batch, and one of every clip.

gather     what the pages show, from the files of a folder of results
render     writes the pages from templates/
"""
