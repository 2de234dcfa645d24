#!/usr/bin/env python3
"""Writes tests/attention/data/golden.safetensors: random weights of every layer, an input and what
PyTorch makes of it, in double precision rounded to float. Odd sizes throughout.

    python3 tests/attention/make_golden.py
"""
import os
import sys

import torch

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import layers


def cases():
    yield "dfc", layers.DfcGate(7, 9), [(1, 7, 11, 13), (1, 9, 11, 13)]
    yield "dfc_even", layers.DfcGate(4, 4), [(2, 4, 6, 34), (2, 4, 6, 34)]
    yield "ghost_relu", layers.GhostModule(5, 9), [(2, 5, 7, 19)]
    yield "ghost_silu", layers.GhostModule(6, 10, "silu"), [(1, 6, 5, 9)]
    yield "bottleneck_s1", layers.GhostBottleneck(6, 11, 6), [(1, 6, 9, 7)]
    yield "bottleneck_s2", layers.GhostBottleneck(5, 8, 7, 2), [(2, 5, 7, 10)]
    yield "bottleneck_wide", layers.GhostBottleneck(4, 6, 8), [(1, 4, 4, 6)]
    yield "c3_relu", layers.GhostV2C3(8, 10, 2), [(1, 8, 15, 5)]
    yield "c3_silu", layers.GhostV2C3(6, 8, 1, False, "silu"), [(2, 6, 6, 8)]
    yield "cbam", layers.Cbam(19, 3), [(2, 19, 9, 11)]
    yield "cbam_spatial_first", layers.Cbam(16, 4, True), [(1, 16, 13, 8)]
    yield "cbam_plain", layers.Cbam(6, 6, bias=False, kernel=3), [(1, 6, 1, 5)]
    yield "fpn", layers.MixedFpn((5, 7, 9), 8, 2), [(1, 5, 11, 14), (1, 7, 6, 7), (1, 9, 3, 4)]


def main():
    torch.manual_seed(1)
    tensors = {}
    for seed, (name, module, shapes) in enumerate(cases()):
        layers.randomize(module, seed)
        inputs = [torch.randn(shape) for shape in shapes]
        tensors.update(layers.state(module, name + ".weights."))
        with torch.no_grad():
            wide = [x.double() for x in inputs]
            outputs = module.double()(wide) if name == "fpn" else module.double()(*wide)
        for i, x in enumerate(inputs):
            tensors[f"{name}.input{i}"] = x
        outputs = outputs if isinstance(outputs, list) else [outputs]
        for i, y in enumerate(outputs):
            tensors[f"{name}.output{i}"] = y.float()
    path = os.path.join(os.path.dirname(os.path.abspath(__file__)), "data", "golden.safetensors")
    os.makedirs(os.path.dirname(path), exist_ok=True)
    layers.write_safetensors(path, tensors, {"torch": torch.__version__})
    print(path, os.path.getsize(path), "bytes")


if __name__ == "__main__":
    main()
