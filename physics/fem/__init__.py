"""Finite elements of soft bodies, with exact derivatives (Frank 2010, section IV).

laws           energy, stress and tangent of the materials; polar: rotations of deformation gradients
solid          nodes and elements, linear or quadratic, and the sums over them
meshing        tetrahedra of a grid's cells, of what an incomplete surface encloses, divided where an instrument presses
curved         quadratic elements whose outer faces follow a surface
surface        places on triangles that are closest to points
equilibrium    rest under forces and prescribed displacements; derivatives by (E, ν) and forces
linear_system  symmetric sparse systems, factorised or iterated
"""

from palpate.common.lazy import exported

__getattr__, __dir__, __all__ = exported(
    {
        "palpate.physics.fem.laws": ("LAWS", "Material"),
        "palpate.physics.fem.solid": ("Solid", "make_solid"),
        "palpate.physics.fem.meshing": ("Meshed", "NoBody", "box", "mesh_surface"),
        "palpate.physics.fem.equilibrium": ("Equilibrium", "NoEquilibrium", "find_equilibrium"),
    }
)
