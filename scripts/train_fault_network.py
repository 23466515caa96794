#!/usr/bin/env python3
"""Trains the networks that tell how likely each sample of a seismic image lies on a fault.

    scripts/train_fault_network.py OUT [--minutes 9] [--from FOLDER] [--rate 3e-3] [--device cuda] [--sections]

The networks are convolutional networks of the U-Net form (Ronneberger et al. 2015; for faults: Wu et al. 2019,
"FaultSeg3D"), one for volumes and one for sections. They learn from synthetic images that this script makes while it
trains: layers of random reflectivity, folded, sheared, eroded and displaced by up to six planar, listric or curved faults
that cross, end at one another or run side by side; noise of several kinds, acquisition footprints, dead traces, bodies of chaos.
No real image and no image of `scripts/fault_trials.py` or `atomesh synth` is used.

OUT/volume.bin and OUT/section.bin get the weights: for each convolution in the order of `UNet.convolutions`, its
weights as f16 (tap, input channel, output channel; the vertical axis of the taps is the fastest) and its biases as f32.
Needs PyTorch. The weights in the repository come from an H200, by three runs, each from the one before: `--minutes 8.3
--seed 2` (signal-to-noise ratios of 0.8 to 20), `--minutes 3.5 --seed 5 --batch 6 --rate 1e-3`, and, since marks are
ridges of 0.75 samples and some faults run beside others, `--minutes 8.8 --seed 11 --batch 6 --rate 2e-3`; for sections a fourth one
on one core of a processor: `--sections --device cpu --minutes 62 --batch 8 --rate 1e-3 --seed 7`, 3,400 steps.
"""
import argparse
import json
import math
import time
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

# Channels at full resolution, and after each halving.
VOLUME_CHANNELS = (8, 16, 32, 48)
SECTION_CHANNELS = (16, 24, 32, 48)
# Width (samples) of the Gaussian under which amplitudes are balanced, and the share of the mean energy added before.
BALANCE_SIGMA = 6.0
MIN_BALANCED_ENERGY = 0.3
# Standard deviation (samples) of the ridge that marks a fault.
RIDGE_SIGMA = 0.75


# --- Images -------------------------------------------------------------------------------------------------------

def uniform(low, high):
    return low + (high - low) * torch.rand(()).item()


def log_uniform(low, high):
    return math.exp(uniform(math.log(low), math.log(high)))


def chance(p):
    return torch.rand(()).item() < p


def smooth_noise(size, period, device, dims=1):
    """Returns smooth random values of unit standard deviation on a grid of `size` samples along `dims` axes."""
    coarse = max(4, int(size / period) + 3)
    noise = torch.randn((1, 1) + (coarse,) * dims, device=device)
    mode = {1: "linear", 2: "bicubic", 3: "trilinear"}[dims]
    fine = F.interpolate(noise, size=(int(size * 1.15) + 1,) * dims, mode=mode, align_corners=True)[0, 0]
    fine = fine[(slice(0, size),) * dims]
    return (fine - fine.mean()) / (fine.std() + 1e-6)


class Fault:
    """A fault u = u(v, z), with u across the strike, v along it and z downwards, in samples."""

    def __init__(self, size, wavelength, device, neighbour=None):
        """With a neighbour, the fault runs beside it: the two are hard to tell apart."""
        self.size, self.device = size, device
        if neighbour is None:
            self.centre = [uniform(0.05, 0.95) * size, uniform(0.05, 0.95) * size]
            self.strike = uniform(0, 2 * math.pi)
            self.dip = uniform(35, 88) if chance(0.4) else uniform(48, 82)
        else:
            self.centre = [c + uniform(-10, 10) for c in neighbour.centre]
            self.strike = neighbour.strike + uniform(-0.35, 0.35) + (math.pi if chance(0.3) else 0)
            self.dip = min(88, max(35, neighbour.dip + uniform(-15, 15)))
        dip = self.dip
        self.cos, self.sin = math.cos(self.strike), math.sin(self.strike)
        curve = uniform(-30, 30) if chance(0.4) else uniform(-6, 6)
        depth = torch.arange(-size, 2 * size, dtype=torch.float32, device=device)
        dips = torch.deg2rad((dip + curve * (0.5 - depth / size)).clamp(30, 89.5))
        offsets = torch.cumsum(1 / torch.tan(dips), 0)
        self.table = torch.stack([offsets - offsets[size + size // 2], torch.sin(dips)])
        self.bend = smooth_noise(2 * size, uniform(0.4, 1.5) * size, device) * uniform(0, 0.03) * size
        self.throw = min(log_uniform(0.12, 1.9) * wavelength, 0.28 * size) * (1 if chance(0.75) else -1)
        self.middle = uniform(0.1, 0.9) * size
        self.half_length = uniform(0.3, 1.2) * size
        self.half_height = uniform(0.3, 1.2) * size
        self.has_tips = chance(0.55)
        # The displacement decays with distance, and is shared by the two sides.
        self.decay = log_uniform(0.3, 6) * size
        self.upper_share = uniform(0.0, 1.0) if chance(0.6) else 0.0

    def steepen(self, stretch):
        """Turns the fault until it dips by 30 degrees or more in the samples of a section along x."""
        least = min(0.6, 0.7 * stretch * math.tan(math.radians(self.dip)))
        while abs(self.cos) * stretch * math.tan(math.radians(self.dip)) < least:
            self.strike = uniform(0, 2 * math.pi)
            self.cos, self.sin = math.cos(self.strike), math.sin(self.strike)

    def interpolate(self, values, at):
        at = at.clamp(0, len(values) - 1.001)
        low = at.long()
        fraction = at - low
        return values[low] * (1 - fraction) + values[low + 1] * fraction

    def undo(self, x, y, z, side):
        """Returns where each place lay before the fault moved, and the distance and the throw there."""
        dx, dy = x - self.centre[0], y - self.centre[1]
        u, v = dx * self.cos + dy * self.sin, -dx * self.sin + dy * self.cos
        offset, sine = self.interpolate(self.table[0], z + self.size), self.interpolate(self.table[1], z + self.size)
        distance = (u - offset - self.interpolate(self.bend, v + self.size)) * sine
        throw = torch.full_like(x, self.throw)
        if self.has_tips:
            r = (v / self.half_length) ** 2 + ((z - self.middle) / self.half_height) ** 2
            throw = throw * (1 - r).clamp(min=0)
        if side is not None:
            throw = throw * side
        hanging = (distance > 0).float()
        move = throw * torch.exp(-distance.abs() / self.decay) * (hanging - self.upper_share)
        slide = offset - self.interpolate(self.table[0], z - move + self.size)
        return x - slide * self.cos, y - slide * self.sin, z - move, distance, throw.abs()


def fold(x, y, z, size):
    """Returns depths before folding."""
    # Strong folds are rarer than gentle ones.
    strength = log_uniform(0.1, 1.0)
    depth = z + uniform(-0.2, 0.2) * (x - size / 2) + uniform(-0.2, 0.2) * (y - size / 2)
    shift = torch.zeros_like(x)
    for _ in range(5):
        direction, period = uniform(0, 2 * math.pi), log_uniform(0.3, 3) * size
        # Slope of at most about 0.35 for each wave.
        height = strength * uniform(0, 0.3) * period / (2 * math.pi)
        k = 2 * math.pi / period
        shift = shift + height * torch.sin(k * (x * math.cos(direction) + y * math.sin(direction)) + uniform(0, 6.3))
    growth = uniform(-0.6, 0.6)
    return depth + shift * (1 + growth * (z / size - 0.5))


def reflectivity(size, wavelength, device):
    """Returns reflection coefficients at an eighth of a sample, from -size to 2 size."""
    fine, count = 8, 3 * size * 8
    mean_thickness = log_uniform(0.12, 0.6) * wavelength
    steps = torch.empty(int(3 * size / mean_thickness * 2) + 8).exponential_() * mean_thickness + 0.3
    at = (torch.cumsum(steps, 0) * fine).long()
    at = at[at < count]
    values = torch.randn(len(at))
    if chance(0.5):
        values = values.sign() * (0.3 + 0.9 * torch.rand(len(at)))
    # Quiet and loud intervals.
    values = values * torch.exp(0.6 * smooth_noise(count, uniform(10, 60) * fine, "cpu")[at])
    table = torch.zeros(count).index_add_(0, at, values)
    kernel = torch.exp(-0.5 * (torch.arange(-24, 25) / (0.5 * fine)) ** 2)
    return F.conv1d(table[None, None], (kernel / kernel.sum())[None, None], padding=24)[0, 0].to(device)


def wavelet(wavelength, device):
    """Returns a zero-phase Ricker or Ormsby-like wavelet with a random phase, at samples."""
    n = int(2 * wavelength)
    t = torch.arange(-n, n + 1, dtype=torch.float32)
    a = (math.pi * t / wavelength) ** 2
    ricker = (1 - 2 * a) * torch.exp(-a)
    if chance(0.4):
        spectrum = torch.fft.fft(torch.fft.ifftshift(ricker))
        signs = torch.sign(torch.fft.fftfreq(len(t)))
        phase = uniform(-math.pi, math.pi)
        ricker = torch.fft.fftshift(torch.fft.ifft(spectrum * torch.exp(1j * phase * signs)).real)
    return ricker.to(device)


def along_depth(volume, kernel):
    """Convolves along z, the last axis."""
    shape = volume.shape
    return F.conv1d(volume.reshape(-1, 1, shape[-1]), kernel[None, None], padding=len(kernel) // 2).reshape(shape)


def blur(volume, sigmas):
    """Convolves with a Gaussian, continued by mirror images, along each of the three axes."""
    volume = volume[None, None]
    for axis, sigma in enumerate(sigmas):
        if sigma <= 0:
            continue
        radius = int(math.ceil(4 * sigma))
        t = torch.arange(-radius, radius + 1, device=volume.device, dtype=torch.float32)
        kernel = torch.exp(-0.5 * (t / sigma) ** 2)
        shape, padding = [1, 1, 1, 1, 1], [0] * 6
        shape[2 + axis] = len(t)
        padding[2 * (2 - axis)] = padding[2 * (2 - axis) + 1] = radius
        mode = "reflect" if radius < volume.shape[2 + axis] else "replicate"
        volume = F.conv3d(F.pad(volume, padding, mode=mode), (kernel / kernel.sum()).reshape(shape))
    return volume[0, 0]


def noise(shape, kernel, device):
    """Returns noise of unit standard deviation of a random kind."""
    total = torch.zeros(shape, device=device)
    for _ in range(2):
        n = torch.randn(shape, device=device)
        kind = uniform(0, 1)
        if kind < 0.35:
            n = along_depth(n, kernel)
        elif kind < 0.6:
            n = blur(n, [uniform(0.3, 1.0)] * 3)
        elif kind < 0.8:
            # Noise that is coherent between neighbouring traces.
            n = along_depth(blur(n, [uniform(0.5, 2.5), uniform(0.5, 2.5), 0]), kernel)
        total += n / (n.std() + 1e-6) * uniform(0.2, 1)
    return total / (total.std() + 1e-6)


def slanted_noise(size, kernel, device):
    """Returns noise in a section that continues along slanted lines, as multiples and steep events do."""
    reach = size // 2
    n = along_depth(torch.randn((size, 1, size + 2 * reach), device=device), kernel)
    n = blur(n, [log_uniform(2, 20), 0, 0])
    slope = uniform(-1, 1) * reach / size * 2 if chance(0.5) else 0.0
    shift = (slope * (torch.arange(size, device=device) - size / 2)).round().long()
    at = torch.arange(size, device=device)[None] + reach + shift[:, None]
    n = torch.gather(n[:, 0], 1, at.clamp(0, n.shape[2] - 1))[:, None]
    return n / (n.std() + 1e-6)


def make_image(size, device, is_section=False):
    """Returns amplitudes, the ridges that mark faults, and weights (0 where no answer is asked for).

    A section is a volume of one sample along y. Its wavelengths may be shorter, its traces farther apart, and its
    faults more."""
    wavelength = log_uniform(4, 24) if is_section else log_uniform(5, 30)
    axis = torch.arange(size, dtype=torch.float32, device=device)
    y_axis = axis[:1] + uniform(0, size) if is_section else axis
    grid = list(torch.meshgrid(axis, y_axis, axis, indexing="ij"))
    # Distances between traces and between samples in time differ.
    stretch = log_uniform(0.7, 1.4) if chance(0.5) else 1.0
    if is_section:
        stretch = log_uniform(0.6, 3)
    place = (grid[0] * stretch, grid[1] * stretch, grid[2])
    count = 0 if chance(0.12) else int(uniform(1, 7 * max(1, stretch) if is_section else 7))
    ridge = torch.zeros_like(grid[0])
    doubtful = torch.zeros_like(grid[0])
    sides, fault = None, None
    # Sections often cross a set of faults in equal steps.
    is_set, spacing = is_section and chance(0.35), uniform(8, 30) * stretch
    if is_set:
        count = int(uniform(4, 14))
    for _ in range(count):
        neighbour = fault if chance(0.9 if is_set else 0.3) else None
        fault = Fault(size, wavelength, device, neighbour)
        if is_section:
            fault.steepen(stretch)
            if neighbour is None:
                fault.centre[0] *= stretch
            elif is_set:
                fault.centre[0] = neighbour.centre[0] + spacing * uniform(0.6, 1.6)
        side = None
        if sides is not None and chance(0.3):
            side = sides if chance(0.5) else 1 - sides
        x, y, z, distance, throw = fault.undo(*place, side)
        place = (x, y, z)
        sides = (distance > 0).float()
        # Throws of less than half a sample cannot be seen.
        visible = ((throw - 0.5) / 1.0).clamp(0, 1)
        if is_section:
            # From distances in the world to those in samples of the section.
            slopes = torch.gradient(distance[:, 0])
            slope = torch.sqrt(slopes[0] ** 2 + slopes[1] ** 2).clamp(0.3, max(1.0, stretch))
            distance = distance / slope[:, None]
        near = torch.exp(-0.5 * (distance / RIDGE_SIGMA) ** 2)
        ridge = torch.maximum(ridge, near * visible)
        weak = (throw > 0.15) & (throw < min(1.5, 0.12 * wavelength + 0.5))
        doubtful = torch.maximum(doubtful, (weak & (distance.abs() < 2)).float())
    depth = fold(*place, size)
    table, kernel = reflectivity(size, wavelength, device), wavelet(wavelength, device)

    def layers(depth):
        at = ((depth + size) * 8).clamp(0, len(table) - 2)
        low = at.long()
        fraction = at - low
        return table[low] * (1 - fraction) + table[low + 1] * fraction

    if chance(0.35):
        # The wavelet across the layers, as in depth images without stretch.
        fine = F.interpolate(kernel[None, None], size=8 * (len(kernel) - 1) + 1, mode="linear", align_corners=True)
        table = F.conv1d(table[None, None], fine, padding=fine.shape[-1] // 2)[0, 0]
        signal = layers(depth)
    else:
        signal = along_depth(layers(depth), kernel)
    if chance(0.3):
        # An unconformity: the layers above a smooth surface are not those below. They may be younger than the faults.
        surface = size * uniform(0.1, 0.9) + smooth_noise(size, uniform(0.3, 1.5) * size, device, 2)[:, : len(y_axis), None] * uniform(0, 8)
        above = grid[2] < surface
        table = reflectivity(size, wavelength, device)
        young = along_depth(layers(grid[2] + uniform(-0.1, 0.1) * grid[0] + uniform(-0.1, 0.1) * grid[1]), kernel)
        if chance(0.6):
            signal = torch.where(above, young / (young.std() + 1e-6) * signal.std(), signal)
            # The wavelet carries a fault a little above the unconformity.
            ridge = torch.where(above, torch.zeros_like(ridge), ridge)
            doubtful = torch.maximum(doubtful, ((grid[2] - surface).abs() < 0.5 * wavelength).float())
    signal = signal / (signal.std() + 1e-6)

    def field(period):
        if is_section:
            return smooth_noise(size, period, device, 2)[:, None]
        return smooth_noise(size, period, device, 3)

    # Amplitudes vary along layers.
    if chance(0.7):
        signal = signal * torch.exp(uniform(0, 0.5) * field(uniform(8, 60)))
    if chance(0.25):
        # Chaos without layers: salt, gas, slumps.
        body = field(uniform(0.25, 0.6) * size) > uniform(1.0, 2.0)
        chaos = noise(signal.shape, kernel, device) * uniform(0.3, 1.2)
        signal = torch.where(body, chaos, signal)
        edge = blur(body.float(), [2.0] * 3)
        ridge = torch.where(body, torch.zeros_like(ridge), ridge)
        doubtful = torch.maximum(doubtful, ((edge > 0.02) & (edge < 0.98) & (ridge > 0)).float())
    if chance(0.5):
        lateral = uniform(0, 1.6)
        signal = blur(signal, [lateral, lateral, 0])
    if chance(0.3):
        # Stripes along lines, as acquisition leaves them.
        t = axis * 2 * math.pi / uniform(4, 16)
        stripes = torch.sin(t + uniform(0, 6)) + uniform(0, 1) * torch.randn(size, device=device)
        stripes = stripes[:, None, None] if is_section or chance(0.5) else stripes[None, :, None]
        fade = torch.exp(-axis / log_uniform(20, 500))[None, None]
        signal = signal * (1 + uniform(0, 0.5) * stripes * fade)
    signal = signal / (signal.std() + 1e-6)
    signal = signal + noise(signal.shape, kernel, device) / log_uniform(0.7, 16)
    if is_section and chance(0.5):
        for _ in range(2):
            signal = signal + slanted_noise(size, kernel, device) / log_uniform(1.5, 16)
    if chance(0.2):
        level = uniform(1.0, 3.0) * signal.std()
        signal = signal.clamp(-level, level)
    if chance(0.2):
        steps = uniform(10, 60) / signal.abs().max()
        signal = torch.round(signal * steps) / steps
    weight = 1 - doubtful
    live = torch.ones((size, len(y_axis), 1), device=device)
    if chance(0.2):
        for _ in range(int(uniform(1, 4))):
            a, b = int(uniform(0, size)), int(uniform(0, len(y_axis)))
            live[a : a + int(log_uniform(1, 20)), b : b + int(log_uniform(1, 60))] = 0
        if chance(0.5):
            live = live * (torch.rand((size, len(y_axis), 1), device=device) > uniform(0, 0.1))
        weight = weight * live
    return balance(signal, live), ridge, weight


def balance(signal, live):
    """Divides amplitudes by their root mean square nearby; dead traces become 0."""
    signal = signal * live
    rms = (signal**2).mean()
    energy = blur(signal**2, [BALANCE_SIGMA] * 3)
    return signal / torch.sqrt(energy + MIN_BALANCED_ENERGY * rms) * live


class Pool:
    """The last images that were made. Each is used several times, turned and flipped in another way."""

    def __init__(self, count, size, device, are_sections=False):
        self.size, self.device, self.are_sections = size, device, are_sections
        self.images = [self.make() for _ in range(count)]

    def make(self):
        return make_image(self.size, self.device, self.are_sections)

    def renew(self, count):
        for _ in range(count):
            self.images[int(uniform(0, len(self.images)))] = self.make()

    def batch(self, count):
        return turned_batch([self.images[int(uniform(0, len(self.images)))] for _ in range(count)], self.are_sections)


def turned_batch(parts, are_sections=False):
    """Returns images, ridges and weights, turned and flipped at random, as batches with one channel."""
    out = []
    for part in parts:
        turned = [p.expand_as(part[0]) for p in part]
        if are_sections:
            turned = [p[:, 0] for p in turned]
        elif chance(0.5):
            turned = [p.transpose(0, 1) for p in turned]
        flips = [a for a in range(turned[0].ndim - 1) if chance(0.5)]
        turned = [torch.flip(p, flips) for p in turned]
        turned[0] = turned[0] * (-1 if chance(0.5) else 1)
        out.append(torch.stack(turned))
    batch = torch.stack(out)
    return batch[:, 0:1], batch[:, 1:2], batch[:, 2:3]


# --- Networks -----------------------------------------------------------------------------------------------------

class Step(nn.Module):
    """A convolution over 3 samples along each axis, normalised, rectified."""

    def __init__(self, dims, inputs, outputs):
        super().__init__()
        conv, norm = ((nn.Conv2d, nn.BatchNorm2d), (nn.Conv3d, nn.BatchNorm3d))[dims - 2]
        self.conv = conv(inputs, outputs, 3, padding=1, bias=False)
        self.norm = norm(outputs, momentum=0.02)

    def forward(self, x):
        return F.relu(self.norm(self.conv(x)))

    def folded(self):
        """Returns the weights and biases of the convolution and its normalisation as one."""
        scale = self.norm.weight / torch.sqrt(self.norm.running_var + self.norm.eps)
        shape = (-1,) + (1,) * (self.conv.weight.ndim - 1)
        return self.conv.weight * scale.reshape(shape), self.norm.bias - self.norm.running_mean * scale


class UNet(nn.Module):
    def __init__(self, dims, channels):
        super().__init__()
        self.dims = dims
        down, up, previous = [], [], 1
        for c in channels:
            down.append(nn.ModuleList([Step(dims, previous, c), Step(dims, c, c)]))
            previous = c
        for c in reversed(channels[:-1]):
            up.append(nn.ModuleList([Step(dims, previous + c, c), Step(dims, c, c)]))
            previous = c
        self.down, self.up = nn.ModuleList(down), nn.ModuleList(up)
        self.last = (nn.Conv2d, nn.Conv3d)[dims - 2](channels[0], 1, 1)

    def forward(self, x):
        pool = (F.max_pool2d, F.max_pool3d)[self.dims - 2]
        skips = []
        for level, steps in enumerate(self.down):
            if level > 0:
                skips.append(x)
                x = pool(x, 2)
            for step in steps:
                x = step(x)
        for steps, skip in zip(self.up, reversed(skips)):
            x = F.interpolate(x, scale_factor=2, mode="nearest")
            x = torch.cat([x, skip], 1)
            for step in steps:
                x = step(x)
        return self.last(x)

    def convolutions(self):
        """Returns weights and biases of all convolutions in the order in which they are applied."""
        steps = [step.folded() for part in (self.down, self.up) for steps in part for step in steps]
        return steps + [(self.last.weight, self.last.bias)]

    def read(self, path, images):
        """Reads the file of `write`. `images` give the normalisations their means and variances."""
        data, at = path.read_bytes(), 0
        steps = [step for part in (self.down, self.up) for steps in part for step in steps]
        layers = [(s.conv.weight, s.norm.bias) for s in steps] + [(self.last.weight, self.last.bias)]
        for weight, bias in layers:
            outputs, inputs = weight.shape[:2]
            taps = np.frombuffer(data, "<f2", weight.numel(), at).reshape(-1, inputs, outputs)
            at += 2 * weight.numel()
            weight.data.copy_(torch.from_numpy(taps.transpose(2, 1, 0).astype(np.float32)).reshape(weight.shape))
            bias.data.copy_(torch.from_numpy(np.frombuffer(data, "<f4", outputs, at).copy()))
            at += 4 * outputs
        for step in steps:
            step.norm.running_mean.zero_()
            step.norm.running_var.fill_(1 - step.norm.eps)
        seen = {}

        def note(step):
            def hook(_module, _input, output):
                seen[step] = torch.var_mean(output.transpose(0, 1).flatten(1), 1)

            return step.conv.register_forward_hook(hook)

        hooks = [note(step) for step in steps]
        self.eval()
        self(images)
        self.train()
        for hook in hooks:
            hook.remove()
        for step, (variance, mean) in seen.items():
            step.norm.running_mean.copy_(mean)
            step.norm.running_var.copy_(variance)
            step.norm.weight.data.copy_(torch.sqrt(variance + step.norm.eps))
            step.norm.bias.data.add_(mean)

    def write(self, path):
        with open(path, "wb") as file:
            for weight, bias in self.convolutions():
                # The images have x, y, z (z vertical and the fastest): the taps keep this order.
                weight = weight.detach().float().cpu()
                taps = weight.reshape(weight.shape[0], weight.shape[1], -1).permute(2, 1, 0).contiguous()
                file.write(taps.numpy().astype("<f2").tobytes())
                file.write(bias.detach().float().cpu().numpy().astype("<f4").tobytes())


def loss(logits, ridge, weight):
    """Returns the weighted cross-entropy, plus one minus the soft Dice coefficient."""
    entropy = F.binary_cross_entropy_with_logits(logits, ridge, reduction="none") * (1 + 2 * ridge)
    entropy = (entropy * weight).sum() / weight.sum().clamp(min=1)
    p = torch.sigmoid(logits) * weight
    r = ridge * weight
    dice = (2 * (p * r).sum() + 1) / ((p * p).sum() + (r * r).sum() + 1)
    return entropy + 0.1 * (1 - dice)


def sections(image, ridge, weight, count):
    """Returns vertical sections of a batch of volumes at random places, along either horizontal axis."""
    size = image.shape[2]
    parts = []
    for _ in range(count):
        at = int(uniform(0, size))
        axis = 2 if chance(0.5) else 3
        parts.append([t.select(axis, at) for t in (image, ridge, weight)])
    return [torch.cat([p[i] for p in parts]) for i in range(3)]


class Average:
    """A running average of a network's weights."""

    def __init__(self, network):
        self.values = {k: v.detach().clone().float() for k, v in network.state_dict().items()}
        self.steps = 0

    def update(self, network):
        self.steps += 1
        keep = min(0.998, self.steps / (self.steps + 10))
        for k, v in network.state_dict().items():
            self.values[k].lerp_(v.float(), 1 - keep)

    def copy_to(self, network):
        network.load_state_dict({k: v.to(network.state_dict()[k].dtype) for k, v in self.values.items()})


def scores(network, batch):
    """Returns recall, precision and mean cross-entropy at a probability of one half."""
    with torch.no_grad():
        p = torch.sigmoid(network(batch[0]).float())
    pool = (F.max_pool2d, F.max_pool3d)[network.dims - 2]
    true, found = (batch[1] > 0.6).float() * batch[2], (p > 0.5).float() * batch[2]
    near_true, near_found = pool((batch[1] > 0.5).float(), 3, 1, 1), pool((p > 0.5).float(), 3, 1, 1)
    recall = (true * near_found).sum() / true.sum().clamp(min=1)
    precision = (found * near_true).sum() / found.sum().clamp(min=1)
    return [round(v.item(), 3) for v in (recall, precision, loss(torch.logit(p.clamp(1e-6, 1 - 1e-6)), *batch[1:]))]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=float, default=9.0)
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--sections", action="store_true", help="train only the network for sections, on sections")
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rate", type=float, default=3e-3, help="largest learning rate")
    parser.add_argument("--from", dest="start", type=Path, help="a folder with weights to train further")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    torch.manual_seed(options.seed)
    torch.backends.cudnn.benchmark = True
    torch.backends.cuda.matmul.allow_tf32 = torch.backends.cudnn.allow_tf32 = True
    device = options.device
    networks = {"section": UNet(2, SECTION_CHANNELS).to(device, memory_format=torch.channels_last)}
    if not options.sections:
        networks["volume"] = UNet(3, VOLUME_CHANNELS).to(device, memory_format=torch.channels_last_3d)
    with torch.no_grad():
        if options.sections:
            pool = Pool(200, options.size, device, are_sections=True)
            held = {"section": turned_batch([pool.make() for _ in range(40)], are_sections=True)}
        else:
            pool = Pool(48 if device == "cuda" else 2, options.size, device)
            volumes = turned_batch([pool.make() for _ in range(8 if device == "cuda" else 1)])
            held = {"volume": volumes, "section": sections(*volumes, 8)}
        for name, network in networks.items():
            if options.start:
                network.read(options.start / f"{name}.bin", held[name][0])
    averages = {name: Average(network) for name, network in networks.items()}
    optimizers = {
        name: torch.optim.AdamW(network.parameters(), lr=options.rate, weight_decay=1e-3)
        for name, network in networks.items()
    }
    start, step, seconds_made = time.time(), 0, 0.0
    total, next_report = 60 * options.minutes, 5.0
    while True:
        elapsed = time.time() - start
        share = elapsed / total
        if share >= 1:
            break
        rate = options.rate * min(1, (step + 1) / 200) * (0.5 + 0.5 * math.cos(math.pi * share)) + 1e-6
        began = time.time()
        with torch.no_grad():
            pool.renew(4 if options.sections else 2)
            batch = pool.batch(options.batch)
        seconds_made += time.time() - began
        batches = {"section": batch} if options.sections else {"volume": batch, "section": sections(*batch, 12)}
        for name, network in networks.items():
            data, optimizer = batches[name], optimizers[name]
            for group in optimizer.param_groups:
                group["lr"] = rate
            layout = torch.channels_last_3d if network.dims == 3 else torch.channels_last
            with torch.autocast(device.split(":")[0], dtype=torch.bfloat16, enabled=device != "cpu"):
                logits = network(data[0].contiguous(memory_format=layout))
            value = loss(logits.float(), *data[1:])
            optimizer.zero_grad(set_to_none=True)
            value.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            averages[name].update(network)
        step += 1
        if time.time() - start > next_report or step == 2:
            next_report = time.time() - start + 30
            report(options.out, averages, held, step, seconds_made, time.time() - start)
    report(options.out, averages, held, step, seconds_made, time.time() - start)


def report(out, averages, held, step, seconds_made, elapsed):
    """Writes the averaged networks, and prints how well they do on images that they have not seen."""
    line = {"step": step, "seconds": round(elapsed), "making": round(seconds_made)}
    for name, average in averages.items():
        image = held[name][0]
        copy = UNet(*((2, SECTION_CHANNELS) if name == "section" else (3, VOLUME_CHANNELS))).to(image.device)
        average.copy_to(copy)
        copy.eval()
        line[name] = scores(copy, held[name])
        copy.write(out / f"{name}.bin")
    print(json.dumps(line), flush=True)


if __name__ == "__main__":
    main()
