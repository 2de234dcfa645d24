"""The layers of the attention room as PyTorch modules, and YOLOv5s-seg with and without them.

Names of weights are those that include/dynslam/attention/safetensors.hpp reads. Written from the
papers and from docs/components/attention.md; runs with PyTorch 1.13 (Debian's python3-torch).
"""
import json
import struct

import torch
import torch.nn as nn
import torch.nn.functional as F


class ConvNorm(nn.Module):
    """Convolution, normalization, activation."""

    def __init__(self, c_in, c_out, kernel=1, stride=1, groups=1, act=None, eps=1e-5, pad=None):
        super().__init__()
        kernel = kernel if isinstance(kernel, tuple) else (kernel, kernel)
        pad = tuple((k - 1) // 2 for k in kernel) if pad is None else pad
        self.conv = nn.Conv2d(c_in, c_out, kernel, stride, pad, groups=groups, bias=False)
        self.bn = nn.BatchNorm2d(c_out, eps=eps)
        self.act = {None: nn.Identity, "relu": nn.ReLU, "silu": nn.SiLU}[act]()

    def forward(self, x):
        return self.act(self.bn(self.conv(x)))


class Dfc(nn.Module):
    """The map of DFC attention, at half resolution."""

    def __init__(self, c_in, c_out, kernel=5):
        super().__init__()
        self.pointwise = ConvNorm(c_in, c_out)
        self.horizontal = ConvNorm(c_out, c_out, (1, kernel), groups=c_out)
        self.vertical = ConvNorm(c_out, c_out, (kernel, 1), groups=c_out)

    def forward(self, x):
        pooled = F.avg_pool2d(x, kernel_size=2, stride=2)
        return torch.sigmoid(self.vertical(self.horizontal(self.pointwise(pooled))))

    def gate(self, x, features):
        size = (int(features.shape[-2]), int(features.shape[-1]))
        return features * F.interpolate(self.forward(x), size=size, mode="nearest")


class DfcGate(nn.Module):
    """DFC attention of one tensor on another, as a network of its own."""

    def __init__(self, c_in, c_out):
        super().__init__()
        self.dfc = Dfc(c_in, c_out)

    def forward(self, x, features):
        return self.dfc.gate(x, features)


class GhostModule(nn.Module):
    def __init__(self, c_in, c_out, act="relu"):
        super().__init__()
        half = (c_out + 1) // 2
        self.c_out = c_out
        self.primary = ConvNorm(c_in, half, act=act)
        self.cheap = ConvNorm(half, half, 3, groups=half, act=act)

    def forward(self, x):
        primary = self.primary(x)
        both = torch.cat([primary, self.cheap(primary)], 1)
        return both if self.c_out % 2 == 0 else both[:, : self.c_out]


class GhostBottleneck(nn.Module):
    def __init__(self, c_in, c_mid, c_out, stride=1, act="relu", shortcut=True, attention=True):
        super().__init__()
        self.expand = GhostModule(c_in, c_mid, act)
        self.attention = Dfc(c_in, c_mid) if attention else None
        self.downsample = ConvNorm(c_mid, c_mid, 3, 2, groups=c_mid) if stride == 2 else None
        self.project = GhostModule(c_mid, c_out, None)
        self.add = shortcut
        self.shortcut_depthwise = self.shortcut_pointwise = None
        if shortcut and (stride == 2 or c_in != c_out):
            self.shortcut_depthwise = ConvNorm(c_in, c_in, 3, stride, groups=c_in)
            self.shortcut_pointwise = ConvNorm(c_in, c_out)

    def forward(self, x):
        y = self.expand(x)
        if self.attention is not None:
            y = self.attention.gate(x, y)
        if self.downsample is not None:
            y = self.downsample(y)
        y = self.project(y)
        if not self.add:
            return y
        if self.shortcut_depthwise is not None:
            x = self.shortcut_pointwise(self.shortcut_depthwise(x))
        return y + x


class GhostV2C3(nn.Module):
    def __init__(self, c_in, c_out, n=1, shortcut=True, act="relu", eps=1e-5):
        super().__init__()
        hidden = c_out // 2
        self.cv1 = ConvNorm(c_in, hidden, act="silu", eps=eps)
        self.cv2 = ConvNorm(c_in, hidden, act="silu", eps=eps)
        self.cv3 = ConvNorm(2 * hidden, c_out, act="silu", eps=eps)
        self.m = nn.Sequential(
            *(GhostBottleneck(hidden, hidden, hidden, 1, act, shortcut) for _ in range(n)))

    def forward(self, x):
        return self.cv3(torch.cat((self.m(self.cv1(x)), self.cv2(x)), 1))


class ChannelAttention(nn.Module):
    def __init__(self, channels, reduced, bias=True):
        super().__init__()
        self.fc0 = nn.Linear(channels, reduced, bias=bias)
        self.fc1 = nn.Linear(reduced, channels, bias=bias)

    def forward(self, x):
        mlp = lambda v: self.fc1(torch.relu(self.fc0(v)))
        mean = F.adaptive_avg_pool2d(x, 1).flatten(1)
        largest = F.adaptive_max_pool2d(x, 1).flatten(1)
        gate = torch.sigmoid(mlp(mean) + mlp(largest))
        return x * gate.unsqueeze(2).unsqueeze(3)


class SpatialAttention(nn.Module):
    def __init__(self, kernel=7):
        super().__init__()
        self.spatial = ConvNorm(2, 1, kernel)

    def forward(self, x):
        pooled = torch.cat([torch.max(x, 1, keepdim=True)[0], torch.mean(x, 1, keepdim=True)], 1)
        return x * torch.sigmoid(self.spatial(pooled))


class Cbam(nn.Module):
    def __init__(self, channels, reduced, spatial_first=False, bias=True, kernel=7):
        super().__init__()
        self.channel = ChannelAttention(channels, reduced, bias)
        self.space = SpatialAttention(kernel)
        self.spatial_first = spatial_first

    def forward(self, x):
        if self.spatial_first:
            return self.channel(self.space(x))
        return self.space(self.channel(x))


class FpnLevel(nn.Module):
    def __init__(self, c_in, channels, reduced):
        super().__init__()
        self.lateral = nn.Sequential()
        self.lateral.add_module("conv", nn.Conv2d(c_in, channels, 1))
        self.attention = Cbam(channels, reduced, spatial_first=True)
        self.smooth = nn.Sequential()
        self.smooth.add_module("conv", nn.Conv2d(channels, channels, 3, padding=1))


class MixedFpn(nn.Module):
    def __init__(self, inputs, channels, reduced):
        super().__init__()
        self.levels = nn.ModuleList(FpnLevel(c, channels, reduced) for c in inputs)

    def forward(self, maps):
        merged = None
        outputs = []
        for level, x in reversed(list(zip(self.levels, maps))):
            y = level.attention(level.lateral(x))
            if merged is not None:
                y = y + F.interpolate(merged, size=y.shape[-2:], mode="nearest")
            merged = y
            outputs.insert(0, level.smooth(y))
        return outputs + [F.max_pool2d(outputs[-1], 1, 2)]


# -------------------------------------------------------------------------------------------------
# YOLOv5s-seg, release 7 (public definition), with its C3 or with GhostV2C3.
# -------------------------------------------------------------------------------------------------
class Bottleneck(nn.Module):
    def __init__(self, c, shortcut):
        super().__init__()
        self.cv1 = ConvNorm(c, c, 1, act="silu", eps=1e-3)
        self.cv2 = ConvNorm(c, c, 3, act="silu", eps=1e-3)
        self.add = shortcut

    def forward(self, x):
        return x + self.cv2(self.cv1(x)) if self.add else self.cv2(self.cv1(x))


class C3(nn.Module):
    def __init__(self, c_in, c_out, n=1, shortcut=True):
        super().__init__()
        hidden = c_out // 2
        self.cv1 = ConvNorm(c_in, hidden, act="silu", eps=1e-3)
        self.cv2 = ConvNorm(c_in, hidden, act="silu", eps=1e-3)
        self.cv3 = ConvNorm(2 * hidden, c_out, act="silu", eps=1e-3)
        self.m = nn.Sequential(*(Bottleneck(hidden, shortcut) for _ in range(n)))

    def forward(self, x):
        return self.cv3(torch.cat((self.m(self.cv1(x)), self.cv2(x)), 1))


class Sppf(nn.Module):
    def __init__(self, c):
        super().__init__()
        self.cv1 = ConvNorm(c, c // 2, act="silu", eps=1e-3)
        self.cv2 = ConvNorm(2 * c, c, act="silu", eps=1e-3)

    def forward(self, x):
        x = self.cv1(x)
        a = F.max_pool2d(x, 5, 1, 2)
        b = F.max_pool2d(a, 5, 1, 2)
        return self.cv2(torch.cat((x, a, b, F.max_pool2d(b, 5, 1, 2)), 1))


class Segment(nn.Module):
    anchors = (((10, 13), (16, 30), (33, 23)), ((30, 61), (62, 45), (59, 119)),
               ((116, 90), (156, 198), (373, 326)))
    classes, masks = 80, 32

    def __init__(self, channels, proto):
        super().__init__()
        self.no = 5 + self.classes + self.masks
        self.heads = nn.ModuleList(nn.Conv2d(c, 3 * self.no, 1) for c in channels)
        self.proto = nn.Sequential(
            ConvNorm(channels[0], proto, 3, act="silu", eps=1e-3), nn.Upsample(scale_factor=2),
            ConvNorm(proto, proto, 3, act="silu", eps=1e-3),
            ConvNorm(proto, self.masks, 1, act="silu", eps=1e-3))

    def forward(self, maps):
        rows = []
        for head, anchors, x, stride in zip(self.heads, self.anchors, maps, (8, 16, 32)):
            ny, nx = int(x.shape[2]), int(x.shape[3])
            n = int(x.shape[0])
            y = head(x).view(n, 3, self.no, ny, nx).permute(0, 1, 3, 4, 2).contiguous()
            gy, gx = torch.meshgrid(torch.arange(ny), torch.arange(nx), indexing="ij")
            grid = torch.stack((gx, gy), 2).float().expand(1, 3, ny, nx, 2) - 0.5
            size = torch.tensor(anchors).float().view(1, 3, 1, 1, 2).expand(1, 3, ny, nx, 2)
            xy, wh, scores, masks = y.split((2, 2, 1 + self.classes, self.masks), 4)
            xy = (xy.sigmoid() * 2 + grid) * float(stride)
            wh = (wh.sigmoid() * 2) ** 2 * size
            y = torch.cat((xy, wh, scores.sigmoid(), masks), 4)
            rows.append(y.view(n, 3 * ny * nx, self.no))
        return torch.cat(rows, 1), self.proto(maps[0])


class Yolov5sSeg(nn.Module):
    """Width 0.5, depth 0.33. `block` is C3 or GhostV2C3."""

    def __init__(self, block):
        super().__init__()
        conv = lambda a, b, k=3, s=2, pad=None: ConvNorm(a, b, k, s, act="silu", eps=1e-3, pad=pad)
        self.b0, self.b1, self.b2 = conv(3, 32, 6, pad=(2, 2)), conv(32, 64), block(64, 64, 1)
        self.b3, self.b4 = conv(64, 128), block(128, 128, 2)
        self.b5, self.b6 = conv(128, 256), block(256, 256, 3)
        self.b7, self.b8, self.b9 = conv(256, 512), block(512, 512, 1), Sppf(512)
        self.n10, self.n13 = conv(512, 256, 1, 1), block(512, 256, 1, False)
        self.n14, self.n17 = conv(256, 128, 1, 1), block(256, 128, 1, False)
        self.n18, self.n20 = conv(128, 128), block(256, 256, 1, False)
        self.n21, self.n23 = conv(256, 256), block(512, 512, 1, False)
        self.head = Segment((128, 256, 512), 128)
        for layer in self.modules():
            if isinstance(layer, nn.BatchNorm2d):
                layer.eps = 1e-3

    def forward(self, x):
        up = lambda t: F.interpolate(t, scale_factor=2.0, mode="nearest")
        p3 = self.b4(self.b3(self.b2(self.b1(self.b0(x)))))
        p4 = self.b6(self.b5(p3))
        t10 = self.n10(self.b9(self.b8(self.b7(p4))))
        t14 = self.n14(self.n13(torch.cat((up(t10), p4), 1)))
        t17 = self.n17(torch.cat((up(t14), p3), 1))
        t20 = self.n20(torch.cat((self.n18(t17), t14), 1))
        t23 = self.n23(torch.cat((self.n21(t20), t10), 1))
        return self.head((t17, t20, t23))


# -------------------------------------------------------------------------------------------------
# Weights
# -------------------------------------------------------------------------------------------------
def randomize(module, seed):
    """Weights, biases and statistics of normalization that make every term of a layer count."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, tensor in module.state_dict().items():
            if not tensor.is_floating_point():
                continue
            noise = torch.randn(tensor.shape, generator=generator)
            if name.endswith("running_var"):
                tensor.copy_(0.5 + torch.rand(tensor.shape, generator=generator))
            elif name.endswith("bn.weight"):
                tensor.copy_(1 + 0.2 * noise)
            elif tensor.dim() > 1:
                tensor.copy_(noise * 1.4 / tensor[0].numel() ** 0.5)
            else:
                tensor.copy_(0.2 * noise)
    return module.eval()


def pictures(shape):
    """Random images with structure at every scale, as photographs have."""
    image = torch.zeros(shape)
    for cells in (2, 4, 8, 16, 32):
        coarse = torch.randn(shape[0], shape[1], cells, cells)
        image += F.interpolate(coarse, shape[2:], mode="bilinear", align_corners=False)
    return torch.sigmoid(image)


def settle(module, shape, seed):
    """Random weights whose normalizations fit the activations, so that a deep network neither fades
    nor explodes."""
    torch.manual_seed(seed)
    for layer in module.modules():
        if isinstance(layer, nn.BatchNorm2d):
            layer.momentum = None
            layer.reset_running_stats()
            # Far from the bend of the activations, where random networks are chaotic: rounding
            # would grow a thousandfold on its way through sixty layers.
            nn.init.constant_(layer.weight, 0.5)
            nn.init.constant_(layer.bias, 0.75)
    module.train()
    with torch.no_grad():
        for _ in range(2):
            module(pictures(shape))
    return module.eval()


def state(module, prefix=""):
    return {prefix + name: tensor for name, tensor in module.state_dict().items()
            if tensor.is_floating_point()}


def write_safetensors(path, tensors, metadata=None):
    header, data = {}, b""
    if metadata:
        header["__metadata__"] = metadata
    for name, tensor in tensors.items():
        raw = tensor.detach().contiguous().float().numpy().astype("<f4").tobytes()
        header[name] = {"dtype": "F32", "shape": list(tensor.shape),
                        "data_offsets": [len(data), len(data) + len(raw)]}
        data += raw
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    with open(path, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text + data)
