"""Extended position-based dynamics of sheets and bodies (Liang 2024, equations 1 to 3), differentiable in stiffness.

body               particles and what joins them: distances, volumes of tetrahedra, shapes of neighbourhoods; below a
                   sheet, a volume
stiffness          fields over particles, and the stiffness of every constraint
simulation         time steps under a grip, batched over states and fields, and their exact adjoint
potential          elastic energy, its gradient, and its second derivatives along a direction
constraint_kernel  compiled values, gradients and second derivatives of one constraint
sweep_kernel       compiled time steps, and back through them
"""
