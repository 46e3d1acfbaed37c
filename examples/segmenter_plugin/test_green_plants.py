import numpy as np
from green_plants import PLANT, GreenPlants

from autonerf_lab.segmentation import check_segmenter


def test_conformance():
    check_segmenter(GreenPlants)


def test_green_is_a_plant():
    image = np.zeros((1, 2, 3), np.uint8)
    image[0, 1] = 40, 160, 50
    assert GreenPlants()(image).labels.tolist() == [[0, PLANT]]
