"""The command ``prosim compare``, which measures the error of integrators and samplers against converged images."""
