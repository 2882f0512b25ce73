"""The ground floor, which knows nothing of the field: what every program needs of files, settings and a terminal.

doors         how programs begin and end; command_line: types of options, sentences, progress bars
options       a dataclass filled in from the command line
files         whole files or none, reading that ends, YAML of our own; output: which files this program may replace
settings      values of settings that come from files; tables: rows as CSV
lazy          package faces that load nothing; provenance: digest of the code
onnx_devices  where ONNX networks run, and opening them
workers       processes that work through tasks; ahead: threads that do so for the next stage
distributed   workers of other machines that do
robust        Student's errors, spreads by medians, affine motions of points
"""
