//! Values of the command line that are more than a number or a path.

use super::formats::{ExportFormat, ImportFormat};
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use rilievo_io::CameraFormat;
use rilievo_poses::KnownDistance;
use rilievo_scene::StageId;

/// `5_shading`, `5` or `shading`.
pub(super) fn parse_stage(text: &str) -> Result<StageId, String> {
    StageId::ALL
        .into_iter()
        .find(|stage| {
            let name = stage.name();
            name == text || name.get(..1) == Some(text) || name.get(2..) == Some(text)
        })
        .ok_or_else(|| {
            let names: Vec<_> = StageId::ALL.iter().map(|stage| stage.name()).collect();
            format!("stages are {}", names.join(", "))
        })
}

/// A camera format, or `diligent`.
pub(super) fn import_formats() -> impl TypedValueParser<Value = ImportFormat> {
    let diligent = ("diligent".into(), ImportFormat::Diligent);
    let cameras = CameraFormat::ALL.map(|f| (f.name().into(), ImportFormat::Cameras(f)));
    one_of(cameras.into_iter().chain([diligent]).collect())
}

/// A camera format, the lamps' or Blender's.
pub(super) fn export_formats() -> impl TypedValueParser<Value = ExportFormat> {
    let cameras = CameraFormat::ALL.map(|f| (f.name().into(), ExportFormat::Cameras(f)));
    let others = [
        ("lp".into(), ExportFormat::Lp),
        ("blender".into(), ExportFormat::Blender),
    ];
    one_of(cameras.into_iter().chain(others).collect())
}

/// Values by their names, which the help lists.
pub(super) fn one_of<T>(values: Vec<(PossibleValue, T)>) -> impl TypedValueParser<Value = T>
where
    T: Copy + Send + Sync + 'static,
{
    let names: Vec<_> = values.iter().map(|(name, _)| name.clone()).collect();
    PossibleValuesParser::new(names).try_map(move |text| {
        let found = values.iter().find(|(name, _)| name.get_name() == text);
        found.map(|(_, value)| *value).ok_or("is none of the words")
    })
}

/// `800M`, `4G`, or a number of bytes.
pub(super) fn parse_size(text: &str) -> Result<u64, String> {
    let trimmed = text
        .trim()
        .trim_end_matches(['b', 'B'])
        .trim_end_matches('i');
    let (number, factor) = match trimmed.char_indices().last() {
        Some((at, 'k' | 'K')) => (&trimmed[..at], 1 << 10),
        Some((at, 'm' | 'M')) => (&trimmed[..at], 1 << 20),
        Some((at, 'g' | 'G')) => (&trimmed[..at], 1 << 30),
        Some((at, 't' | 'T')) => (&trimmed[..at], 1u64 << 40),
        _ => (trimmed, 1),
    };
    match number.trim().parse::<f64>() {
        Ok(value) if value.is_finite() && value * factor as f64 >= 1.0 => {
            Ok((value * factor as f64) as u64)
        }
        _ => Err("a size looks like 800M or 4G".to_owned()),
    }
}

/// `IMG_1.jpg,IMG_2.jpg,0.35`
pub(super) fn parse_known_distance(text: &str) -> Result<KnownDistance, String> {
    let wrong = || "a known distance looks like IMG_1.jpg,IMG_2.jpg,0.35".to_owned();
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    let [first, second, metres] = parts[..] else {
        return Err(wrong());
    };
    let known = KnownDistance {
        metres: metres.parse().map_err(|_| wrong())?,
        sigma_metres: 0.0,
        cameras: Some([first.to_owned(), second.to_owned()]),
        marks: Vec::new(),
    };
    known.validate().map_err(|error| error.to_string())?;
    Ok(known)
}

/// `640x480`
pub(super) fn parse_dimensions(text: &str) -> Result<(usize, usize), String> {
    text.split_once(['x', 'X'])
        .and_then(|(width, height)| Some((width.parse().ok()?, height.parse().ok()?)))
        .ok_or_else(|| "a size looks like 640x480".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_sizes_and_dimensions_are_understood() {
        assert_eq!(parse_stage("3_poses"), Ok(StageId::Poses));
        assert_eq!(parse_stage("5"), Ok(StageId::Shading));
        assert_eq!(parse_stage("fusion"), Ok(StageId::Fusion));
        assert!(parse_stage("7").is_err());
        assert_eq!(parse_size("2G"), Ok(2 << 30));
        assert_eq!(parse_size("1.5GiB"), Ok(3 << 29));
        assert_eq!(parse_size("800m"), Ok(800 << 20));
        assert!(parse_size("much").is_err() && parse_size("-1G").is_err());
        assert_eq!(parse_dimensions("640x480"), Ok((640, 480)));
        assert!(parse_dimensions("640").is_err());
        let known = parse_known_distance("a.jpg, b.jpg,0.35").unwrap();
        assert_eq!(
            known.cameras,
            Some(["a.jpg".to_owned(), "b.jpg".to_owned()])
        );
        assert!(parse_known_distance("a.jpg,0.35").is_err());
        assert!(parse_known_distance("a.jpg,b.jpg,-1").is_err());
    }
}
