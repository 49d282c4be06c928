"""Reads an exported folder with pycocotools and ElementTree, and compares what they find with the label maps."""

import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
from PIL import Image
from pycocotools import mask as coco_mask
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

folder = Path(sys.argv[1])
coco = COCO(str(folder / "annotations.json"))
names = {category["id"]: category["name"] for category in coco.loadCats(coco.getCatIds())}
objects = 0
for image_id in coco.getImgIds():
    info = coco.loadImgs(image_id)[0]
    stem = Path(info["file_name"]).stem
    picture = Image.open(folder / "images" / info["file_name"])
    assert picture.size == (info["width"], info["height"]) and picture.mode == "RGB"
    label = np.asarray(Image.open(folder / "labels" / f"{stem}.png"))
    painted = np.zeros_like(label)
    annotations = coco.loadAnns(coco.getAnnIds(imgIds=image_id))
    lines = (folder / "labels" / f"{stem}.txt").read_text().splitlines()
    root = ElementTree.parse(folder / "voc" / f"{stem}.xml").getroot()
    entries = root.findall("object")
    assert len(annotations) == len(lines) == len(entries)
    for annotation, line, entry in zip(annotations, lines, entries):
        mask = coco.annToMask(annotation)
        assert mask.shape == label.shape and mask.sum() == annotation["area"]
        assert coco_mask.toBbox(coco.annToRLE(annotation)).tolist() == annotation["bbox"]
        assert not painted[mask > 0].any(), "visible masks do not overlap"
        painted[mask > 0] = annotation["category_id"]
        left, top, width, height = annotation["bbox"]
        kind, x, y, across, down = map(float, line.split())
        size = np.array([info["width"], info["height"]])
        yolo = np.concatenate([([x, y] - np.array([across, down]) / 2) * size, np.array([across, down]) * size])
        assert kind == annotation["category_id"] - 1 and np.allclose(yolo, annotation["bbox"], atol=1e-3)
        assert entry.findtext("name") == names[annotation["category_id"]]
        corners = [int(entry.findtext(f"bndbox/{tag}")) for tag in ("xmin", "ymin", "xmax", "ymax")]
        assert corners == [left + 1, top + 1, left + width, top + height]
        objects += 1
    assert (painted == label).all(), "the masks of an image are its label map"
assert objects > 0

# Perfect detections must score 1, which they do only if ids, boxes and masks are what the evaluation takes them for.
perfect = [dict(image_id=a["image_id"], category_id=a["category_id"], segmentation=a["segmentation"], bbox=a["bbox"],
                score=1.0) for a in coco.loadAnns(coco.getAnnIds())]
for kind in ("segm", "bbox"):
    evaluation = COCOeval(coco, coco.loadRes([dict(p) for p in perfect]), kind)
    evaluation.evaluate()
    evaluation.accumulate()
    evaluation.summarize()
    assert evaluation.stats[0] == 1.0, evaluation.stats
print(f"{objects} objects in {len(coco.getImgIds())} images, AP of perfect detections 1.0")
