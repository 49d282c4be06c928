//! Features of each cell of the 1/8 grid.

use burn::tensor::{Tensor, TensorData};
use image::RgbImage;

use crate::kernels::{Shape, resize};
use crate::{BiSeNet, Error, Normalization, Result};

/// Features of an image, and a constant 1 behind them.
pub(super) struct PixelFeatures {
    /// `[height, width, channels]`.
    pub(super) values: Vec<f32>,
    /// Height and width of the grid, an eighth of the image's.
    pub(super) size: [usize; 2],
}

/// Channels of [`PixelFeatures`].
pub(super) fn channels(net: &BiSeNet) -> usize {
    net.config().backbone.channels(net.config()).iter().sum::<usize>() + 1
}

/// Of a network on a plain device.
///
/// Maps are laid over the image whole. Strictly, the padding of the convolutions of stride 2 moves what a value looks at
/// by half a cell; taking that back helps random features (synthetic blocks: IoU 0.825 to 0.875), but not those of
/// ImageNet (the cabinet at 288x160: 0.903 to 0.886).
pub(super) fn pixel_features(net: &BiSeNet, image: &RgbImage, normalization: &Normalization) -> Result<PixelFeatures> {
    let shape = [1, 3, image.height() as usize, image.width() as usize];
    let image = Tensor::from_data(TensorData::new(normalization.planes(image), shape), &net.device());
    let features = net.features(image);
    let [_, _, height, width] = features.stride8.dims();
    let maps = [features.stride8, features.stride16, features.stride32];
    let maps = maps.map(|map| enlarged(map, [height, width])).into_iter().collect::<Result<Vec<_>>>()?;
    let mut values = Vec::with_capacity(height * width * channels(net));
    for cell in 0..height * width {
        for (map, channels) in &maps {
            values.extend_from_slice(&map[cell * channels..][..*channels]);
        }
        values.push(1.0);
    }
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(Error::FeatureNotFinite { channel: index % channels(net), value: values[index] }),
        None => Ok(PixelFeatures { values, size: [height, width] }),
    }
}

/// `[1, channels, height, width]` as `[height, width, channels]` of another size, and the number of channels.
fn enlarged(map: Tensor<4>, to: [usize; 2]) -> Result<(Vec<f32>, usize)> {
    let [batch, channels, height, width] = map.dims();
    let pixels = map.permute([0, 2, 3, 1]).into_data().convert::<f32>().try_into_vec::<f32>();
    let pixels = pixels.map_err(|error| Error::Burn(format!("{error:?}")))?;
    let mut large = vec![0.0; to[0] * to[1] * channels];
    resize(&pixels, Shape { batch, height, width, channels }, to, &mut large);
    Ok((large, channels))
}
