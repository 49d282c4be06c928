"""The classification networks that supply the features, as `segnet` builds them. Needs torch; `bisenet.py` uses it."""

import math
from functools import partial

import torch
import torch.nn as nn
import torch.nn.functional as F


class Conv(nn.Conv2d):
    """Convolution without bias; `padding` is Symmetric, TensorFlowSame, or Valid for none."""

    def __init__(self, cin, cout, kernel, stride=1, groups=1, padding="Symmetric"):
        zeros = kernel // 2 if padding == "Symmetric" else 0
        super().__init__(cin, cout, kernel, stride, zeros, groups=groups, bias=False)
        self.tensorflow_same = padding == "TensorFlowSame"

    def forward(self, x):
        if self.tensorflow_same:
            x = padded_same(x, self.kernel_size[0], self.stride[0], 0.0)
        return super().forward(x)


def padded_same(x, kernel, stride, value):
    """As few pixels around as give ceil(size / stride) outputs, the odd one at the bottom and the right."""

    def around(size):
        pixels = max((-(-size // stride) - 1) * stride + kernel - size, 0)
        return [pixels // 2, pixels - pixels // 2]

    return F.pad(x, around(x.shape[3]) + around(x.shape[2]), value=value)


def max_pooled(x, padding):
    """Over 3x3 windows of stride 2; what lies beside the map never wins."""
    if padding == "TensorFlowSame":
        return F.max_pool2d(padded_same(x, 3, 2, -math.inf), 3, 2)
    return F.max_pool2d(x, 3, 2, padding=1)


class ConvBn(nn.Module):
    """Convolution, or a depthwise one and a 1x1 (`separable`), batch norm, activation."""

    def __init__(
        self, cin, cout, kernel, stride=1, groups=1, act=F.relu, eps=1e-5, padding="Symmetric", separable=False
    ):
        super().__init__()
        self.depthwise = Conv(cin, cin, kernel, stride, cin, padding) if separable else None
        self.conv = Conv(cin, cout, 1) if separable else Conv(cin, cout, kernel, stride, groups, padding)
        self.bn = nn.BatchNorm2d(cout, eps=eps)
        self.act = act

    def forward(self, x):
        x = self.depthwise(x) if self.depthwise else x
        x = self.bn(self.conv(x))
        return self.act(x) if self.act else x


def backbone_conv(net):
    """`ConvBn` as the description wants it in a backbone."""
    return partial(ConvBn, eps=net.epsilon, padding=net.padding)


class InvertedResidual(nn.Module):
    def __init__(self, cin, cout, stride, expansion, conv_bn):
        super().__init__()
        middle = cin * expansion
        self.skip = stride == 1 and cin == cout
        self.expand = conv_bn(cin, middle, 1, act=F.relu6) if expansion > 1 else None
        self.depthwise = conv_bn(middle, middle, 3, stride, groups=middle, act=F.relu6)
        self.project = conv_bn(middle, cout, 1, act=None)

    def forward(self, x):
        y = self.expand(x) if self.expand else x
        y = self.project(self.depthwise(y))
        return x + y if self.skip else y


class MobileNetV2(nn.Module):
    """Features at 1/16 and 1/32 (Sandler et al. 2018)."""

    # Table 2 of the paper: expansion, channels, repetitions, stride of the first.
    STAGES = [(1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1), (6, 160, 3, 2), (6, 320, 1, 1)]
    STRIDE16_BLOCK = 12

    def __init__(self, net):
        super().__init__()
        conv_bn = backbone_conv(net)
        cin = net.channels(32)
        self.stem = conv_bn(3, cin, 3, 2, act=F.relu6)
        self.blocks = nn.ModuleList()
        for expansion, channels, repetitions, stride in self.STAGES:
            for repetition in range(repetitions):
                cout = net.channels(channels)
                self.blocks.append(InvertedResidual(cin, cout, 1 if repetition else stride, expansion, conv_bn))
                cin = cout
        self.channels = net.channels(self.STAGES[4][1]), cin

    def forward(self, x):
        x = self.stem(x)
        for index, block in enumerate(self.blocks):
            x = block(x)
            if index == self.STRIDE16_BLOCK:
                stride16 = x
        return stride16, x


class Residual(nn.Module):
    def __init__(self, cin, middle, cout, stride, bottleneck, conv_bn):
        super().__init__()
        if bottleneck:
            convs = [conv_bn(cin, middle, 1), conv_bn(middle, middle, 3, stride), conv_bn(middle, cout, 1, act=None)]
        else:
            convs = [conv_bn(cin, middle, 3, stride), conv_bn(middle, cout, 3, act=None)]
        self.convs = nn.Sequential(*convs)
        self.shortcut = conv_bn(cin, cout, 1, stride, act=None) if stride > 1 or cin != cout else None

    def forward(self, x):
        return F.relu(self.convs(x) + (self.shortcut(x) if self.shortcut else x))


class ResNet(nn.Module):
    """Features at 1/16 and 1/32 (He et al. 2016); a bottleneck's stride lies in its 3x3 convolution."""

    WIDTHS = [64, 128, 256, 512]
    EXPANSION = 4

    def __init__(self, net, blocks, bottleneck):
        super().__init__()
        conv_bn = backbone_conv(net)
        cin = net.channels(self.WIDTHS[0])
        self.padding = net.padding
        self.stem = conv_bn(3, cin, 7, 2)
        self.stages = nn.Sequential()
        ends = []
        for stage, (width, count) in enumerate(zip(self.WIDTHS, blocks)):
            middle = net.channels(width)
            cout = middle * self.EXPANSION if bottleneck else middle
            residuals = []
            for block in range(count):
                stride = 2 if stage > 0 and block == 0 else 1
                residuals.append(Residual(cin, middle, cout, stride, bottleneck, conv_bn))
                cin = cout
            self.stages.append(nn.Sequential(*residuals))
            ends.append(cout)
        self.channels = ends[2], ends[3]

    def forward(self, x):
        x = max_pooled(self.stem(x), self.padding)
        stride16 = self.stages[:3](x)
        return stride16, self.stages[3](stride16)


class BnAct(nn.Module):
    """Batch norm, activation."""

    def __init__(self, channels, eps, act=F.relu):
        super().__init__()
        self.bn = nn.BatchNorm2d(channels, eps=eps)
        self.act = act

    def forward(self, x):
        x = self.bn(x)
        return self.act(x) if self.act else x


class DenseLayer(nn.Module):
    BOTTLENECK = 4

    def __init__(self, cin, growth, net):
        super().__init__()
        middle = self.BOTTLENECK * growth
        self.norm = BnAct(cin, net.epsilon)
        self.narrow = backbone_conv(net)(cin, middle, 1)
        self.conv = Conv(middle, growth, 3)

    def forward(self, x):
        return torch.cat([x, self.conv(self.narrow(self.norm(x)))], 1)


class Transition(nn.Module):
    """Halves the channels, then the size; an odd row or column falls away."""

    def __init__(self, cin, net):
        super().__init__()
        self.norm = BnAct(cin, net.epsilon)
        self.conv = Conv(cin, cin // 2, 1)

    def forward(self, x):
        return F.avg_pool2d(self.conv(self.norm(x)), 2)


class DenseNet121(nn.Module):
    """Features at 1/16 and 1/32 (Huang et al. 2017), the latter behind the last batch norm, not rectified."""

    LAYERS = [6, 12, 24, 16]
    GROWTH = 32

    def __init__(self, net):
        super().__init__()
        growth, cin = net.channels(self.GROWTH), net.channels(64)
        self.padding = net.padding
        self.stem = backbone_conv(net)(3, cin, 7, 2)
        self.blocks, self.transitions = nn.ModuleList(), nn.ModuleList()
        ends = []
        for block, count in enumerate(self.LAYERS):
            if block > 0:
                self.transitions.append(Transition(cin, net))
                cin //= 2
            layers = nn.Sequential()
            for _ in range(count):
                layers.append(DenseLayer(cin, growth, net))
                cin += growth
            self.blocks.append(layers)
            ends.append(cin)
        self.norm = BnAct(cin, net.epsilon, act=None)
        self.channels = ends[2], ends[3]

    def forward(self, x):
        x = self.blocks[0](max_pooled(self.stem(x), self.padding))
        for transition, block in zip(self.transitions, self.blocks[1:]):
            stride16, x = x, block(transition(x))
        return stride16, self.norm(x)


class XceptionBlock(nn.Module):
    """Separable convolutions, with stride 2 a max pool, and a sum with the input."""

    def __init__(self, channels, stride, rectifies, padding, conv_bn):
        super().__init__()
        self.rectifies, self.padding = rectifies, padding
        pairs = list(zip(channels, channels[1:]))
        acts = [F.relu] * (len(pairs) - 1) + [None]
        self.separables = nn.Sequential(*(conv_bn(*pair, 3, act=act, separable=True) for pair, act in zip(pairs, acts)))
        self.shortcut = conv_bn(channels[0], channels[-1], 1, stride, act=None) if stride > 1 else None

    def forward(self, x):
        y = self.separables(F.relu(x) if self.rectifies else x)
        return self.shortcut(x) + max_pooled(y, self.padding) if self.shortcut else x + y


class Xception(nn.Module):
    """Features at 1/16 and 1/32 (Chollet 2017). The first two convolutions are never padded."""

    # Figure 5 of the paper: channels of the input and each separable convolution, stride, whether a ReLU comes first.
    BLOCKS = [
        ([64, 128, 128], 2, False),
        ([128, 256, 256], 2, True),
        ([256, 728, 728], 2, True),
        *[([728] * 4, 1, True)] * 8,
        ([728, 728, 1024], 2, True),
    ]

    def __init__(self, net):
        super().__init__()
        conv_bn = backbone_conv(net)
        first, second, middle, last, wide, widest = (net.channels(paper) for paper in (32, 64, 728, 1024, 1536, 2048))
        self.stem = nn.Sequential(
            conv_bn(3, first, 3, 2, padding="Valid"),
            conv_bn(first, second, 3, padding="Valid"),
        )
        self.blocks = nn.Sequential()
        for papers, stride, rectifies in self.BLOCKS:
            channels = [net.channels(paper) for paper in papers]
            self.blocks.append(XceptionBlock(channels, stride, rectifies, net.padding, conv_bn))
        self.tail = nn.Sequential(conv_bn(last, wide, 3, separable=True), conv_bn(wide, widest, 3, separable=True))
        self.channels = middle, widest

    def forward(self, x):
        stride16 = self.blocks[:-1](self.stem(x))
        return stride16, self.tail(self.blocks[-1](stride16))


BACKBONES = {
    "MobileNetV2": MobileNetV2,
    "ResNet18": partial(ResNet, blocks=[2, 2, 2, 2], bottleneck=False),
    "ResNet50": partial(ResNet, blocks=[3, 4, 6, 3], bottleneck=True),
    "DenseNet121": DenseNet121,
    "Xception": Xception,
}
