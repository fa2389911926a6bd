"""How kernels run: layout of patches in memory, cores, nets, exact and soft maxima, plain pytrees."""
