#!/usr/bin/env python3
"""Exports the layers and the networks as ONNX graphs with random weights.

    python3 tests/attention/export_onnx.py <directory> [--only NAME...] [--size HEIGHT WIDTH] [--jit]
    python3 tests/attention/export_onnx.py --count

Beside every <name>.onnx stands <name>.safetensors: the weights below "weights.", an input and
PyTorch's output; with --jit <name>.pt too, for libtorch. --count prints parameters and multiply-additions of YOLOv5s-seg with C3 and with
GhostV2C3.
"""
import argparse
import os
import sys
import warnings

import torch
import torch.nn as nn

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import layers

LAYERS = {
    "dfc_64x80": (lambda: layers.DfcGate(64, 64), [(1, 64, 80, 80)] * 2),
    "dfc_128x40": (lambda: layers.DfcGate(128, 128), [(1, 128, 40, 40)] * 2),
    "dfc_256x20": (lambda: layers.DfcGate(256, 256), [(1, 256, 20, 20)] * 2),
    "c3_64x80": (lambda: layers.GhostV2C3(64, 64), [(1, 64, 80, 80)]),
    "c3_64x40": (lambda: layers.GhostV2C3(64, 64), [(1, 64, 40, 40)]),
    "c3_128x80": (lambda: layers.GhostV2C3(128, 128), [(1, 128, 80, 80)]),
    "c3_128x40": (lambda: layers.GhostV2C3(128, 128), [(1, 128, 40, 40)]),
    "cbam_256x160": (lambda: layers.Cbam(256, 16), [(1, 256, 160, 160)]),
    "cbam_512x80": (lambda: layers.Cbam(512, 32), [(1, 512, 80, 80)]),
    "cbam_1024x40": (lambda: layers.Cbam(1024, 64), [(1, 1024, 40, 40)]),
    "cbam_2048x20": (lambda: layers.Cbam(2048, 128), [(1, 2048, 20, 20)]),
    # Small and odd, for the tests.
    "small_dfc": (lambda: layers.DfcGate(6, 8), [(1, 6, 9, 12), (1, 8, 9, 12)]),
    "small_ghost": (lambda: layers.GhostModule(5, 9), [(1, 5, 7, 10)]),
    "small_bottleneck": (lambda: layers.GhostBottleneck(5, 8, 7, 2), [(1, 5, 10, 7)]),
    "small_c3": (lambda: layers.GhostV2C3(6, 8, 2), [(1, 6, 7, 10)]),
    "small_c3_silu": (lambda: layers.GhostV2C3(6, 8, 1, False, "silu"), [(1, 6, 8, 8)]),
    "small_cbam": (lambda: layers.Cbam(10, 3), [(1, 10, 9, 8)]),
    "small_cbam_spatial_first": (lambda: layers.Cbam(10, 3, True), [(1, 10, 9, 8)]),
}


def export(module, inputs, path, output_names=None):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(module, tuple(inputs), path, opset_version=12, do_constant_folding=True,
                          input_names=[f"input{i}" for i in range(len(inputs))]
                          if output_names is None else ["images"],
                          output_names=output_names or ["output0"])


def export_layer(name, directory, jit):
    make, shapes = LAYERS[name]
    torch.manual_seed(len(name))
    module = layers.randomize(make(), 7)
    inputs = [torch.randn(shape) for shape in shapes]
    export(module, inputs, os.path.join(directory, name + ".onnx"))
    tensors = layers.state(module, "weights.")
    if jit:
        traced = torch.jit.trace(module, tuple(inputs))
        torch.jit.freeze(traced).save(os.path.join(directory, name + ".pt"))
    with torch.no_grad():
        tensors["output0"] = module(*inputs)
    for i, x in enumerate(inputs):
        tensors[f"input{i}"] = x
    layers.write_safetensors(os.path.join(directory, name + ".safetensors"), tensors)


def network(block):
    torch.manual_seed(3)
    return layers.settle(layers.Yolov5sSeg(block), (4, 3, 192, 192), 4)


def export_network(name, block, directory, size):
    module = network(block)
    image = layers.pictures((1, 3, *size))
    export(module, [image], os.path.join(directory, name + ".onnx"), ["output0", "output1"])
    with torch.no_grad():
        rows, proto = module(image)
    layers.write_safetensors(os.path.join(directory, name + ".safetensors"),
                             {"input0": image, "output0": rows, "output1": proto})


def count(module):
    total = [0]

    def add(layer, _, y):
        total[0] += y[0].numel() * layer.weight[0].numel()

    for layer in module.modules():
        if isinstance(layer, nn.Conv2d):
            layer.register_forward_hook(add)
    with torch.no_grad():
        module.eval()(torch.rand(1, 3, 640, 640))
    return sum(p.numel() for p in module.parameters()), total[0]


def main():
    networks = {"yolov5s_seg_ghost": layers.GhostV2C3, "yolov5s_seg": layers.C3}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("directory", nargs="?")
    parser.add_argument("--only", nargs="+", choices=list(LAYERS) + list(networks))
    parser.add_argument("--size", nargs=2, type=int, default=(640, 640))
    parser.add_argument("--jit", action="store_true")
    parser.add_argument("--count", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.count:
        for name, block in networks.items():
            parameters, macs = count(layers.Yolov5sSeg(block))
            print(f"{name}: {parameters} parameters, {2e-9 * macs:.2f} GFLOP at 640x640")
        return
    if arguments.directory is None:
        parser.error("a directory to write to, please")
    os.makedirs(arguments.directory, exist_ok=True)
    for name in arguments.only or list(LAYERS) + list(networks):
        if name in LAYERS:
            export_layer(name, arguments.directory, arguments.jit)
        else:
            export_network(name, networks[name], arguments.directory, arguments.size)


if __name__ == "__main__":
    main()
