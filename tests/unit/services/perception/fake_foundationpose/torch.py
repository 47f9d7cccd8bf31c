"""As much of torch as a pose takes on its way to the GPU."""

import numpy as np

float32 = np.float32


def as_tensor(values, device, dtype):
    assert device == "cuda"
    return np.asarray(values, dtype)
