#!/usr/bin/env python3
"""Writes the tiny networks of the tests: ONNX graphs with the exact output layouts of the real ones.

Needs nothing but Python. An ONNX file is a protocol buffer; the few messages that are needed are
written by hand below (field numbers from onnx.proto3). Run it in this folder.
"""
import struct

# ------------------------------------------------------------------------- protocol buffer, ONNX
FLOAT, INT64 = 1, 7


def varint(n):
    n &= (1 << 64) - 1
    out = b""
    while n > 127:
        out += bytes([n & 127 | 128])
        n >>= 7
    return out + bytes([n])


def number(field, value):
    return varint(field << 3) + varint(value)


def message(field, content):
    if isinstance(content, str):
        content = content.encode()
    return varint(field << 3 | 2) + varint(len(content)) + content


def tensor(name, dims, values, kind=FLOAT):
    body = b"".join(number(1, d) for d in dims) + number(2, kind)
    body += message(8, name)
    return body + message(9, struct.pack("<%d%s" % (len(values), "f" if kind == FLOAT else "q"), *values))


def attribute(name, value):
    body = message(1, name)
    if isinstance(value, int):
        return body + number(3, value) + number(20, 2)
    if isinstance(value, float):
        return body + varint(2 << 3 | 5) + struct.pack("<f", value) + number(20, 1)
    return body + b"".join(number(8, v) for v in value) + number(20, 7)


def node(kind, inputs, outputs, **attributes):
    body = b"".join(message(1, i) for i in inputs) + b"".join(message(2, o) for o in outputs)
    body += message(3, outputs[0]) + message(4, kind)
    return body + b"".join(message(5, attribute(k, v)) for k, v in attributes.items())


def value_info(name, dims):
    shape = b""
    for d in dims:
        shape += message(1, message(2, d) if isinstance(d, str) else number(1, d))
    return message(1, name) + message(2, message(1, number(1, FLOAT) + message(2, shape)))


def model(nodes, weights, inputs, outputs, metadata=None):
    graph = b"".join(message(1, n) for n in nodes) + message(2, "tiny")
    graph += b"".join(message(5, w) for w in weights)
    graph += b"".join(message(11, value_info(*i)) for i in inputs)
    graph += b"".join(message(12, value_info(*o)) for o in outputs)
    body = number(1, 8) + message(2, "dynslam tests") + message(7, graph)
    body += message(8, message(1, "") + number(2, 13))
    for key, value in (metadata or {}).items():
        body += message(14, message(1, key) + message(2, value))
    return body


def write(name, content):
    with open(name, "wb") as file:
        file.write(content)
    print(name, len(content))


# ------------------------------------------------------------------------- pieces of graphs
def constant_output(tag, values, shape, image="images"):
    """The values whatever the image shows: pooled to one number, times zero, plus the values."""
    count = len(values)
    nodes = [
        node("Conv", [image, tag + "_w0"], [tag + "_one"], kernel_shape=[1, 1]),
        node("GlobalAveragePool", [tag + "_one"], [tag + "_pooled"]),
        node("Conv", [tag + "_pooled", tag + "_w1", tag + "_b1"], [tag + "_flat"], kernel_shape=[1, 1]),
        node("Reshape", [tag + "_flat", tag + "_shape"], [tag]),
    ]
    weights = [
        tensor(tag + "_w0", [1, 3, 1, 1], [0.0, 0.0, 0.0]),
        tensor(tag + "_w1", [count, 1, 1, 1], [0.0] * count),
        tensor(tag + "_b1", [count], values),
        tensor(tag + "_shape", [len(shape)], shape, INT64),
    ]
    return nodes, weights


def colour_prototypes(tag, count):
    """Prototype 0 is red - 0.5, prototype 1 is green - 0.5, the others 0, at a quarter of the size."""
    w = [0.0] * (count * 3)
    w[0] = 1.0
    w[3 + 1] = 1.0
    b = [0.0] * count
    b[0] = b[1] = -0.5
    nodes = [
        node("AveragePool", ["images"], [tag + "_small"], kernel_shape=[4, 4], strides=[4, 4]),
        node("Conv", [tag + "_small", tag + "_w", tag + "_b"], [tag], kernel_shape=[1, 1]),
    ]
    return nodes, [tensor(tag + "_w", [count, 3, 1, 1], w), tensor(tag + "_b", [count], b)]


# ------------------------------------------------------------------------- YOLO segmentation
WIDTH, HEIGHT, CANDIDATES = 96, 64, 60
NAMES = {"names": "{0: 'person', 1: \"office chair\", 2: 'dog'}"}
# candidate: cx, cy, w, h, objectness, class probabilities, prototype, expected to be found
FOUND = {
    3: (24.0, 32.0, 32.0, 40.0, 0.9, (0.9, 0.1, 0.1), 0),   # person, mask where it is red
    5: (26.0, 33.0, 32.0, 40.0, 0.9, (0.8, 0.1, 0.1), 0),   # the same person, weaker: goes
    7: (24.0, 32.0, 32.0, 40.0, 0.8, (0.1, 0.1, 0.75), 1),  # a dog there too, where it is green: stays
    9: (70.0, 32.0, 20.0, 20.0, 0.2, (0.1, 0.9, 0.1), 0),   # a chair of score 0.18: goes
    11: (90.0, 60.0, 40.0, 40.0, 1.0, (0.1, 0.6, 0.1), 0),  # a chair that hangs out of the image
}


def yolo_seg(columns):
    coefficients = 32
    rows = []
    for i in range(CANDIDATES):
        cx, cy, w, h, objectness, classes, prototype = FOUND.get(i, (8.0, 8.0, 4.0, 4.0, 0.01, (0.1,) * 3, 0))
        mask = [2.0 if c == prototype else 0.0 for c in range(coefficients)]
        if columns:
            rows.append([cx, cy, w, h] + [objectness * c for c in classes] + mask)
        else:
            rows.append([cx, cy, w, h, objectness] + list(classes) + mask)
    width = len(rows[0])
    if columns:
        values = [rows[i][v] for v in range(width) for i in range(CANDIDATES)]
        shape = [1, width, CANDIDATES]
    else:
        values = [v for row in rows for v in row]
        shape = [1, CANDIDATES, width]
    n0, w0 = constant_output("output0", values, shape)
    n1, w1 = colour_prototypes("output1", coefficients)
    outputs = [("output0", shape), ("output1", [1, coefficients, HEIGHT // 4, WIDTH // 4])]
    return n0 + n1, w0 + w1, outputs


IMAGES = ("images", [1, 3, HEIGHT, WIDTH])
for version, columns in ((5, False), (8, True)):
    nodes, weights, outputs = yolo_seg(columns)
    write("tiny_yolov%d_seg.onnx" % version, model(nodes, weights, [IMAGES], outputs, NAMES))
    if version == 5:
        write("tiny_open_size.onnx", model(
            nodes, weights, [("images", ["batch", 3, "height", "width"])],
            [("output0", ["batch", "n", "values"]), ("output1", ["batch", 32, "h", "w"])], NAMES))
        write("tiny_wrong_names.onnx", model(nodes, weights, [IMAGES], outputs, {"names": "{0: 'a', 1: 'b'}"}))

# ------------------------------------------------------------------------- boxes only
def yolox():
    """Raw head: two cells of 64 x 64 (84 cells) see something, one at stride 8 and one at stride 32."""
    rows = [[0.0, 0.0, 0.0, 0.0, 0.01, 0.1, 0.1] for _ in range(64 + 16 + 4)]
    # stride 8, column 3, row 2: centre (3.5 * 8, 2.25 * 8), size 8 * exp(1.0986) = 24 x 16
    rows[2 * 8 + 3] = [0.5, 0.25, 1.0986123, 0.6931472, 0.9, 0.1, 0.9]
    # stride 32, column 1, row 0: centre (1.5 * 32, 0.5 * 32), size 32 x 32
    rows[64 + 16 + 1] = [0.5, 0.5, 0.0, 0.0, 0.8, 0.9, 0.1]
    return rows


rows = yolox()
nodes, weights = constant_output("output", [v for r in rows for v in r], [1, 84, 7])
write("tiny_yolox.onnx", model(nodes, weights, [("images", [1, 3, 64, 64])], [("output", [1, 84, 7])],
                               {"names": "{0: 'person', 1: 'ball'}"}))
rows = [[8.0, 8.0, 4.0, 4.0, 0.01, 0.1, 0.1] for _ in range(40)]
rows[5] = [32.0, 24.0, 20.0, 16.0, 0.9, 0.1, 0.9]
nodes, weights = constant_output("output", [v for r in rows for v in r], [1, 40, 7])
write("tiny_yolov5.onnx", model(nodes, weights, [("images", [1, 3, 64, 64])], [("output", [1, 40, 7])]))

# ------------------------------------------------------------------------- Mask R-CNN, torchvision
def mask_rcnn():
    """An image without a batch goes in; boxes, labels (int64), scores and 28 x 28 masks come out.
    Runs in ONNX Runtime only, so it may use constants that do not depend on the image."""
    boxes = [8.0, 8.0, 40.0, 56.0, 50.0, 10.0, 60.0, 20.0, 0.0, 0.0, 5.0, 5.0]
    masks = []
    for i in range(3):
        for y in range(28):
            masks += [0.9 if x < 14 else 0.1 for x in range(28)]
    weights = [
        tensor("boxes_c", [3, 4], boxes), tensor("labels", [3], [1, 18, 3], INT64),
        tensor("scores_c", [3], [0.95, 0.6, 0.1]), tensor("masks_c", [3, 1, 28, 28], masks),
        tensor("zero", [1], [0.0]),
    ]
    nodes = [
        node("ReduceMean", ["image"], ["mean"], axes=[0, 1, 2], keepdims=0),
        node("Mul", ["mean", "zero"], ["nothing"]),
        node("Add", ["boxes_c", "nothing"], ["boxes"]),
        node("Identity", ["labels"], ["labels_out"]),
        node("Add", ["scores_c", "nothing"], ["scores"]),
        node("Add", ["masks_c", "nothing"], ["masks"]),
    ]
    outputs = [("boxes", [3, 4]), ("scores", [3]), ("masks", [3, 1, 28, 28])]
    body = model(nodes, weights, [("image", [3, 64, 96])], outputs)
    return nodes, weights, outputs, body


def value_info_int64(name, dims):
    shape = b"".join(message(1, number(1, d)) for d in dims)
    return message(1, name) + message(2, message(1, number(1, INT64) + message(2, shape)))


def mask_rcnn_model():
    nodes, weights, _, _ = mask_rcnn()
    graph = b"".join(message(1, n) for n in nodes) + message(2, "tiny")
    graph += b"".join(message(5, w) for w in weights)
    graph += message(11, value_info("image", [3, 64, 96]))
    graph += message(12, value_info("boxes", [3, 4])) + message(12, value_info_int64("labels_out", [3]))
    graph += message(12, value_info("scores", [3])) + message(12, value_info("masks", [3, 1, 28, 28]))
    body = number(1, 8) + message(2, "dynslam tests") + message(7, graph)
    return body + message(8, message(1, "") + number(2, 13))


write("tiny_mask_rcnn.onnx", mask_rcnn_model())

# ------------------------------------------------------------------------- semantic map
# Class 1 where the (normalized) image is red, class 2 where it is green, else class 0; a quarter of the size.
weights = [tensor("w", [3, 3, 1, 1], [0.0, 0.0, 0.0, 4.0, -4.0, -4.0, -4.0, 4.0, -4.0]),
           tensor("b", [3], [0.0, 0.0, 0.0])]
nodes = [node("AveragePool", ["image"], ["small"], kernel_shape=[4, 4], strides=[4, 4]),
         node("Conv", ["small", "w", "b"], ["out"], kernel_shape=[1, 1])]
write("tiny_semantic.onnx", model(nodes, weights, [("image", [1, 3, 64, 96])], [("out", [1, 3, 16, 24])],
                                  {"names": "{0: 'background', 1: 'person', 2: 'plant'}"}))

# ------------------------------------------------------------------------- networks of another kind
nodes, weights = constant_output("scores", [0.1, 0.2, 0.3, 0.4], [1, 4])
write("tiny_classifier.onnx", model(nodes, weights, [IMAGES], [("scores", [1, 4])]))
write("tiny_two_inputs.onnx", model(
    [node("Add", ["left", "right"], ["sum"])], [], [("left", [1, 3, 8, 8]), ("right", [1, 3, 8, 8])],
    [("sum", [1, 3, 8, 8])]))

# ------------------------------------------------------------------------- Darknet
# One convolution that gives 3 anchors x (4 + 1 + 1 class) at 4 x 4 cells, weights 0: objectness and
# class come from the biases, so that every cell sees a thing of the second anchor's size, 16 x 16.
biases = []
for anchor in range(3):
    biases += [0.0, 0.0, 0.0, 0.0, 4.0 if anchor == 1 else -9.0, 4.0]
count = 18 * 3 * 8 * 8
header = struct.pack("<iiiq", 0, 2, 5, 0)
write("tiny_darknet.weights", header + struct.pack("<18f", *biases) + struct.pack("<%df" % count, *([0.0] * count)))

# ------------------------------------------------------------------------- YOLOv4-tiny, Darknet
# The layers of yolov4-tiny.cfg with an eighth of the filters or less, 64 x 64 pixels and one class.
# All weights are 0; the last convolutions' biases make one anchor of each head see something.
ANCHORS = "anchors=4,6, 8,12, 10,10, 20,24, 30,30, 50,60"


def convolution(filters, size=3, stride=1, last=False):
    lines = ["[convolutional]"] + ([] if last else ["batch_normalize=1"])
    lines += ["filters=%d" % filters, "size=%d" % size, "stride=%d" % stride, "pad=1"]
    return lines + ["activation=%s" % ("linear" if last else "leaky"), ""]


def route(layers, *more):
    return ["[route]", "layers=" + layers] + list(more) + [""]


def yolo(mask):
    return ["[yolo]", "mask=" + mask, ANCHORS, "classes=1", "num=6", "jitter=.3", "scale_x_y = 1.05",
            "ignore_thresh=.7", "nms_kind=greedynms", "beta_nms=0.6", ""]


def csp_block(filters):
    return (convolution(2 * filters) + route("-1", "groups=2", "group_id=1") + convolution(filters) +
            convolution(filters) + route("-1,-2") + convolution(2 * filters, 1) + route("-6,-1") +
            ["[maxpool]", "size=2", "stride=2", ""])


cfg = ["[net]", "width=64", "height=64", "channels=3", ""]
cfg += convolution(2, 3, 2) + convolution(4, 3, 2) + csp_block(2) + csp_block(4) + csp_block(8) + convolution(32)
cfg += convolution(8, 1) + convolution(16) + convolution(18, 1, 1, True) + yolo("3,4,5")
cfg += route("-4") + convolution(4, 1) + ["[upsample]", "stride=2", ""] + route("-1, 23")
cfg += convolution(8) + convolution(18, 1, 1, True) + yolo("0,1,2")
with open("tiny_yolov4.cfg", "w") as file:
    file.write("# Layers of yolov4-tiny.cfg, narrow. Made by make_networks.py.\n" + "\n".join(cfg))


def darknet_weights(lines, heads):
    """Walks the layers as Darknet does; `heads`: the anchor (0 to 2) that each head sees."""
    numbers, channels, at = [], [], {}
    sections = []
    for line in lines:
        if line.startswith("["):
            sections.append((line, {}))
        elif "=" in line:
            key, value = line.split("=", 1)
            sections[-1][1][key.strip()] = value.strip()
    for kind, values in sections[1:]:
        before = channels[-1] if channels else 3
        if kind == "[convolutional]":
            filters, size = int(values["filters"]), int(values["size"])
            if values.get("batch_normalize") == "1":
                numbers += [0.0] * filters + [1.0] * filters + [0.0] * filters + [1.0] * filters
            else:
                seen = heads.pop(0)
                for anchor in range(3):
                    numbers += [0.0] * 4 + [4.0 if anchor == seen else -9.0, 4.0]
            numbers += [0.0] * (filters * before * size * size)
            channels.append(filters)
        elif kind == "[route]":
            layers = [int(v) for v in values["layers"].split(",")]
            channels.append(sum(channels[v] for v in layers) // int(values.get("groups", 1)))
        else:
            channels.append(before)
    return struct.pack("<iiiq", 0, 2, 5, 0) + struct.pack("<%df" % len(numbers), *numbers)


write("tiny_yolov4.weights", darknet_weights(cfg, [0, 1]))


# ------------------------------------------------------------------------- Mask R-CNN, torchvision, pasted
def mask_rcnn_pasted():
    """What torchvision really exports: masks over the whole input, and outputs named by numbers."""
    width, height = 96, 64
    masks = []
    for i in range(2):
        for y in range(height):
            masks += [0.9 if 8 <= x < 24 and 8 <= y < 56 and i == 0 else 0.0 for x in range(width)]
    weights = [
        tensor("boxes_c", [2, 4], [8.0, 8.0, 40.0, 56.0, 50.0, 10.0, 60.0, 20.0]), tensor("labels", [2], [1, 18], INT64),
        tensor("scores_c", [2], [0.95, 0.6]), tensor("masks_c", [2, 1, height, width], masks), tensor("zero", [1], [0.0]),
    ]
    nodes = [
        node("ReduceMean", ["image"], ["mean"], axes=[0, 1, 2], keepdims=0), node("Mul", ["mean", "zero"], ["nothing"]),
        node("Add", ["boxes_c", "nothing"], ["6568"]), node("Identity", ["labels"], ["6570"]),
        node("Add", ["scores_c", "nothing"], ["6572"]), node("Add", ["masks_c", "nothing"], ["6887"]),
    ]
    graph = b"".join(message(1, n) for n in nodes) + message(2, "tiny")
    graph += b"".join(message(5, w) for w in weights)
    graph += message(11, value_info("image", [3, "height", "width"]))
    graph += message(12, value_info("6568", ["n", 4])) + message(12, value_info_int64("6570", [2]))
    graph += message(12, value_info("6572", ["n"])) + message(12, value_info("6887", ["n", 1, "height", "width"]))
    return number(1, 8) + message(2, "dynslam tests") + message(7, graph) + message(8, message(1, "") + number(2, 13))


write("tiny_mask_rcnn_pasted.onnx", mask_rcnn_pasted())


# ------------------------------------------------------------------------- Mask R-CNN, TensorFlow
# A GraphDef with the two layers that OpenCV's reading of the object detection API's graphs ends in
# (field numbers from graph.proto, node_def.proto, attr_value.proto, tensor.proto).
DT_FLOAT, DT_INT32 = 1, 3


def tf_shape(dims):
    return b"".join(message(2, number(1, d)) for d in dims)


def tf_const(name, dims, values, kind=DT_FLOAT):
    content = struct.pack("<%d%s" % (len(values), "f" if kind == DT_FLOAT else "i"), *values)
    value = number(1, kind) + message(2, tf_shape(dims)) + message(4, content)
    return tf_node("Const", name, [], dtype=number(6, kind), value=message(8, value))


def tf_node(op, name, inputs, **attributes):
    body = message(1, name) + message(2, op) + b"".join(message(3, i) for i in inputs)
    return body + b"".join(message(5, message(1, k) + message(2, v)) for k, v in attributes.items())


def tf_ints(values):
    return message(1, b"".join(number(3, v) for v in values))


FLOAT_TYPE = number(6, DT_FLOAT)
CONV = dict(T=FLOAT_TYPE, strides=tf_ints([1, 1, 1, 1]), padding=message(2, "VALID"), data_format=message(2, "NHWC"))


def tf_constant(name, values, size):
    count = len(values)
    return [
        tf_const(name + "/w0", [size, size, 3, 1], [0.0] * (size * size * 3)),
        tf_node("Conv2D", name + "/one", ["image_tensor", name + "/w0"], **CONV),
        tf_const(name + "/w1", [1, 1, 1, count], [0.0] * count),
        tf_node("Conv2D", name + "/flat", [name + "/one", name + "/w1"], **CONV),
        tf_const(name + "/b1", [count], values),
        tf_node("BiasAdd", name + "/biased", [name + "/flat", name + "/b1"], T=FLOAT_TYPE),
    ]


def tf_reshaped(name, source, shape):
    return [tf_const(name + "/shape", [len(shape)], shape, DT_INT32),
            tf_node("Reshape", name, [source, name + "/shape"], T=FLOAT_TYPE)]


def tf_constant_boxes(name, values, size):
    """1 x 1 x n x 7. OpenCV takes a Reshape to that for NHWC and turns it, so three dimensions are packed to four."""
    nodes = tf_constant(name, values, size) + tf_reshaped(name + "/rows", name + "/biased", [1, len(values) // 7, 7])
    return nodes + [tf_node("Pack", name, [name + "/rows"], axis=number(3, 0), N=number(3, 1), T=FLOAT_TYPE)]


def mask_rcnn_tensorflow(boxes_name="detection_out_final", classes=3):
    size = 32
    rows = [[0, 0, 0.95, 0.25, 0.25, 0.75, 0.75], [0, 2, 0.6, 0.0, 0.5, 0.25, 1.0], [0, 1, 0.1, 0.0, 0.0, 1.0, 1.0]]
    boxes = [float(v) for row in rows for v in row]
    masks = []
    for i in range(3):
        for c in range(classes):
            for y in range(15):
                # Each detection's own class has the left or the right half, the others nothing.
                own = c == rows[i][1]
                masks += [0.9 if own and (x < 7) == (i == 0) else 0.1 for x in range(15)]
    nodes = [tf_node("Placeholder", "image_tensor", [], dtype=FLOAT_TYPE, shape=message(7, tf_shape([1, size, size, 3])))]
    nodes += tf_constant_boxes(boxes_name, boxes, size)
    nodes += tf_constant("detection_masks", masks, size)
    nodes += tf_reshaped("detection_masks", "detection_masks/biased", [3, classes, 15, 15])
    return b"".join(message(1, n) for n in nodes)


write("tiny_mask_rcnn_tensorflow.pb", mask_rcnn_tensorflow())
write("tiny_other_tensorflow.pb", mask_rcnn_tensorflow("boxes"))
