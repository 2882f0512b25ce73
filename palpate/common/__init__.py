"""Files, settings and terminals, as every program needs them; knows nothing of the field.

doors         how programs begin and end; command_line: sentences and progress bars
options       command lines from dataclasses; registry: components by name, also those of other packages
files         whole files or none, reading that ends, YAML of our own; output: which files this program may replace
settings      values of settings that come from files; tables: rows as CSV
lazy          public names of packages, loaded when asked for; provenance: digest of the code
onnx_devices  where ONNX networks run, and opening them
workers       processes that work through tasks; ahead: threads that do so for the next stage
distributed   workers of other machines; stages: time that stages take
heap          what the C library keeps of freed memory
robust        Student's errors, spreads by medians, affine motions of points
"""
