"""What a measured force tells of tissue (Frank 2010), with a deformed surface or without one.

curves      tables of probes and of indentations that are held
indentation one force–depth curve: a modulus where the indenter is stated, a stiffness in N/mm otherwise
stiffening  how a curve stiffens, and forces beyond its largest depth
region      the curves of many probes, and what a probe elsewhere on the same tissue will feel
relaxation  how a force falls while the depth is held: standard linear solids
skin        a scanned surface on coarser tetrahedra, and the closest places on it
registration depth points laid onto a surface (ICP); several depth views of a body as one surface
bench       a body on which tools pressed, simulated, and where sensors' sights meet it
gauss_newton points' distances from a simulated surface, linearised by the material and the poses, and their least sum
stiffening_check whether a palpated body stiffens, or its mesh or law makes it look so
material_fit Young's modulus and Poisson's ratio from forces and deformed surfaces
scene       the file that names a surface and what was pressed on it, or a sequence beside a robot
presses     what such a sequence shows: the surface at rest, and each press's largest force
"""

from palpate.common.lazy import exported

__getattr__, __dir__, __all__ = exported(
    {
        "palpate.estimators.palpation.curves": ("Hold", "Probe", "read_hold", "read_probes"),
        "palpate.estimators.palpation.indentation": ("Indenter", "fit_indentation"),
        "palpate.estimators.palpation.region": ("fit_region",),
        "palpate.estimators.palpation.relaxation": ("fit_relaxation",),
        "palpate.estimators.palpation.skin": ("Skin", "cover"),
        "palpate.estimators.palpation.bench": ("Palpation",),
        "palpate.estimators.palpation.material_fit": ("FitSettings", "fit_material"),
    },
)
