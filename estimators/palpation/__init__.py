"""What a measured force tells of tissue (Frank 2010), with a deformed surface or without one.

curves      tables of probes, of indentations that are held, and of grasps
indentation one force–depth curve: a modulus where the indenter is stated, a stiffness in N/mm otherwise
region      the curves of many probes, and what a probe elsewhere on the same tissue will feel
relaxation  how a force falls while the depth is held: standard linear solids
grasp       stiffness of an object between two jaws
"""

from physics.lazy import exported

__getattr__ = exported(
    {
        "estimators.palpation.curves": ("Grasp", "Hold", "Probe", "read_grasp", "read_hold", "read_probes"),
        "estimators.palpation.indentation": ("Indenter", "Indentation", "fit_indentation"),
        "estimators.palpation.region": ("Region", "fit_region"),
        "estimators.palpation.relaxation": ("Viscoelastic", "fit_relaxation"),
        "estimators.palpation.grasp": ("GraspSlope", "fit_grasp"),
    }
)
