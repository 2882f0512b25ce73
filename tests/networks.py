"""Small networks as ONNX files, from graphs in ONNX's own text form."""

from pathlib import Path
from typing import Any

import onnx
from onnx import numpy_helper, parser


def write_network(path: Path, graph: str, metadata: dict[str, str] | None = None, **constants: Any) -> Path:
    """Write a graph of an opset that every supported onnxruntime reads; arrays are its constants by their names."""
    model = parser.parse_model(f'<ir_version: 9, opset_import: ["": 18]> {graph}')
    model.graph.initializer.extend(numpy_helper.from_array(value, name) for name, value in constants.items())
    onnx.helper.set_model_props(model, metadata or {})
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, path)
    return path
