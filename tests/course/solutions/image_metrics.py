"""Notebook 08: right answers in other styles, wrong ones with the start of the hint that they get."""

import math

import numpy as np
import torch
from scipy.spatial import distance
from skimage.metrics import peak_signal_noise_ratio


def psnr_loop(image, target):
    total = sum((a - b) ** 2 for a, b in zip(image.flat, target.flat, strict=True))
    return 10 * math.log10(image.size / total)


def mse(a, b):
    return distance.sqeuclidean(a.ravel(), b.ravel()) / a.size


def iou_loop(confusion):
    result = []
    for k in range(len(confusion)):
        wrong = sum(confusion[k]) - confusion[k, k] + sum(confusion[:, k]) - confusion[k, k]
        result.append(confusion[k, k] / (confusion[k, k] + wrong))
    return result


def pixels(confusion):
    """Return true and predicted class of every pixel."""
    return np.repeat(np.argwhere(confusion >= 0), confusion.ravel(), axis=0).T


def iou_pixels(confusion):
    true, predicted = pixels(confusion)
    return [
        np.sum((true == k) & (predicted == k)) / np.sum((true == k) | (predicted == k)) for k in range(len(confusion))
    ]


def accuracy_loop(confusion):
    shares = [row[k] / row.sum() for k, row in enumerate(confusion) if row.any()]
    return sum(shares) / len(shares)


def accuracy_pixels(confusion):
    true, predicted = pixels(confusion)
    return np.mean([np.mean(predicted[true == k] == k) for k in np.unique(true)])


def recall(confusion):
    with np.errstate(invalid="ignore"):
        return confusion.diagonal() / confusion.sum(1)


RIGHT = {
    "08-psnr": (
        psnr_loop,
        lambda a, b: peak_signal_noise_ratio(b, a, data_range=1),
        lambda a, b: (
            -10 * torch.log10(torch.nn.functional.mse_loss(torch.tensor(a, requires_grad=True), torch.tensor(b)))
        ),
        lambda a, b: -20 * math.log10(math.sqrt(mse(a, b))),
        lambda a, b: -10 * np.log10(np.mean(np.square(np.float32(a) - np.float32(b)))),
        lambda a, b: -10 * math.log(mse(a, b)) / math.log(10),
    ),
    "08-iou": (
        iou_loop,
        iou_pixels,
        lambda c: 1 / (c.sum(0) / c.diagonal().clip(1e-12) + c.sum(1) / c.diagonal().clip(1e-12) - 1),
        lambda c: (t := torch.tensor(c).float()).diagonal() / (t.sum(0) + t.sum(1) - t.diagonal()),
        lambda c: np.float32([c[k, k] / (c[k].sum() + c[:, k].sum() - c[k, k]) for k in range(len(c))]),
    ),
    "08-class-accuracy": (
        accuracy_loop,
        accuracy_pixels,
        lambda c: np.float32(accuracy_loop(c)),
        lambda c: np.nanmean(recall(c)),
        lambda c: torch.tensor(recall(c), requires_grad=True).nanmean(),
        lambda c: np.average(recall(c)[c.any(axis=1)]),
    ),
}
WRONG = {
    "08-psnr": (
        ("The sign is wrong", lambda a, b: 10 * math.log10(mse(a, b))),
        ("20 log10 applies", lambda a, b: -20 * np.log10(np.mean((a - b) ** 2))),
        ("Decibels use", lambda a, b: -10 * math.log(mse(a, b))),
        ("These are absolute", lambda a, b: -20 * torch.log10(torch.tensor(a - b).abs().mean())),
        ("The peak is 1", lambda a, b: peak_signal_noise_ratio(b, a, data_range=255)),
        ("This is the mean squared", mse),
    ),
    "08-iou": (
        ("This is the recall", recall),
        ("This is the precision", lambda c: [c[k, k] / sum(c[:, k]) for k in range(len(c))]),
        ("The denominator counts", lambda c: [c[k, k] / (sum(c[k]) + sum(c[:, k])) for k in range(len(c))]),
        ("This is the Dice", lambda c: torch.tensor([2 * c[k, k] / (sum(c[k]) + sum(c[:, k])) for k in range(len(c))])),
        ("This is the mean", lambda c: float(np.mean(iou_loop(c)))),
    ),
    "08-class-accuracy": (
        ("This is the accuracy over pixels", lambda c: np.mean(np.equal(*pixels(c)))),
        ("A class without true pixels", lambda c: np.nan_to_num(recall(c)).mean()),
        ("0 / 0 gives NaN", lambda c: torch.tensor(recall(c)).mean()),
        ("This is the mean precision", lambda c: accuracy_loop(c.T)),
        (
            "This is the mean IoU",
            lambda c: np.nanmean(iou_pixels(c)) if c[2].any() or c[:, 2].any() else np.mean(iou_pixels(c[:2, :2])),
        ),
        ("expected a number, got an array of shape (3,)", recall),
    ),
}
