"""Young's modulus and Poisson's ratio from measured forces and the deformed surfaces that they leave (Frank 2010).

skin        a scanned surface on coarser tetrahedra, and the closest places on it
registration depth points laid onto a surface (ICP)
bench       a body on which tools pressed, simulated, and where sensors' sights meet it
gauss_newton points' distances from a simulated surface, linearised by the material and the poses, and their least sum
material_fit Young's modulus and Poisson's ratio from forces and deformed surfaces
scene       the file that names a surface and what was pressed on it
"""
