//! What the user should know of a result: the stages find it, one table here has the words.
//!
//! A stage's report makes its findings from its own numbers and thresholds (`findings.rs` of each
//! stage). What a finding means for the result, and what to do about it, stands in [the
//! table](FindingCode) alone.

use crate::naming::first_and_more;
use serde::{Serialize, Serializer};

/// How far a result can be relied on, best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub enum Verdict {
    /// Nothing speaks against it.
    #[serde(rename = "good")]
    Good,
    /// To be used with care.
    #[serde(rename = "usable")]
    Usable,
    /// For programs a usable one: what there is of it is no worse, and the findings say what is
    /// missing.
    #[serde(rename = "usable")]
    NotFinished,
    /// Wrong, or likely so.
    #[serde(rename = "untrusted")]
    NotToBeTrusted,
}

impl Verdict {
    /// On a result with these findings: the worst of their severities.
    pub fn of(findings: &[Finding]) -> Self {
        let severities = findings.iter().map(Finding::severity);
        severities.max().unwrap_or(Self::Good)
    }

    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Usable => "usable, with care",
            Self::NotFinished => "not finished",
            Self::NotToBeTrusted => "not to be trusted",
        }
    }
}

/// A fact that speaks against a result, or a note. As JSON it has `code`, `severity`, `subject`, `numbers`
/// where there are any, and `sentence`.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// What it is, with its numbers: of several photos those of the first.
    pub code: FindingCode,
    /// Photos, views or errors that it is about, the worst first; empty where it is about the
    /// whole.
    pub subject: Vec<String>,
}

impl From<FindingCode> for Finding {
    fn from(code: FindingCode) -> Self {
        let subject = Vec::new();
        Self { code, subject }
    }
}

impl Finding {
    /// A finding about `names`; `None` without any.
    pub fn about<'a>(names: impl IntoIterator<Item = &'a str>, code: FindingCode) -> Option<Self> {
        let subject: Vec<String> = names.into_iter().map(str::to_owned).collect();
        (!subject.is_empty()).then_some(Self { code, subject })
    }

    /// One finding about all that are named with a number, the largest first, which makes the code.
    pub fn largest<'a>(
        cases: impl IntoIterator<Item = (&'a str, f64)>,
        code: impl FnOnce(f64) -> FindingCode,
    ) -> Option<Self> {
        let mut cases: Vec<(&str, f64)> = cases.into_iter().collect();
        cases.sort_by(|a, b| b.1.total_cmp(&a.1));
        let code = code(cases.first()?.1);
        Self::about(cases.into_iter().map(|(name, _)| name), code)
    }

    /// As [`Self::largest`], the smallest first.
    pub fn smallest<'a>(
        cases: impl IntoIterator<Item = (&'a str, f64)>,
        code: impl FnOnce(f64) -> FindingCode,
    ) -> Option<Self> {
        let cases = cases.into_iter().map(|(name, number)| (name, -number));
        Self::largest(cases, |number| code(-number))
    }
}

impl Serialize for Finding {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Written<'a> {
            #[serde(flatten)]
            code: FindingCode,
            severity: Verdict,
            subject: &'a [String],
            sentence: String,
        }
        let written = Written {
            code: self.code,
            severity: self.severity(),
            subject: &self.subject,
            sentence: self.sentence(),
        };
        written.serialize(to)
    }
}

/// The table: of each code its numbers, its severity, and what is said with what to try. `{first}`
/// is the first of the subject, whose numbers they are; `{names}` are some of them.
macro_rules! findings {
    ($first:ident, $names:ident;
     $($code:ident $({ $($number:ident),+ })? $severity:ident $sentence:literal)+) => {
        /// What can be found; a program reads its name in snake case.
        #[derive(Clone, Copy, Debug, PartialEq, Serialize)]
        #[serde(tag = "code", content = "numbers", rename_all = "snake_case")]
        pub enum FindingCode {
            $(#[doc = $sentence] $code $({ $(#[doc = stringify!($number)] $number: f64),+ })?),+
        }

        impl Finding {
            /// The best verdict that it allows: `Good` of a note, on what the run has mended itself.
            pub fn severity(&self) -> Verdict {
                match self.code {
                    $(FindingCode::$code { .. } => Verdict::$severity),+
                }
            }

            /// What it is and what to try, for people.
            pub fn sentence(&self) -> String {
                let $first = self.subject.first().map_or("", String::as_str);
                let $names = first_and_more(self.subject.iter().map(String::as_str)).unwrap_or_default();
                let (of_the_first, sentence) = match self.code {
                    $(FindingCode::$code $({ $($number),+ })? =>
                        ($sentence.contains("{first}"), format!($sentence))),+
                };
                match self.subject.len() {
                    num @ 2.. if of_the_first => format!("{num} photos ({}): {sentence}", $names),
                    _ => sentence,
                }
            }
        }
    };
}

findings! { first, names;
    // The run.
    RunFailed NotToBeTrusted "the run did not end: {names}"
    NotFused NotFinished "there is no point cloud and no mesh yet"
    FusionStale NotFinished "point cloud and mesh are stale: they were made from something else than what is \
        asked for now"
    FusionDamaged NotToBeTrusted "point cloud and mesh are damaged: {names}"
    MasksProposed Usable "the masks were proposed by the program: look at masks-overlays/ in the run directory, \
        correct what is wrong in masks/, and give them with --masks"

    // Photos.
    PhotosMirrored NotToBeTrusted "{names}: EXIF says that the stored pixels are the scene's mirror image, and so is \
        the model; store them unmirrored"
    PhotosRejected { photos } Usable "{photos} photo(s) could not be used"
    MasksNone Usable "no photo has an object mask: what stands around the object was taken for a part of it; \
        `rilievo mask` proposes masks, --masks uses them"
    MasksMissing { missing, photos } Usable "{missing} of {photos} photos have no object mask: what stands around the \
        object was taken for a part of it; `rilievo mask` proposes masks, --masks uses them"
    MaskTooLarge Usable "{names}: the mask reaches beyond the object's outline along most of its border, and what \
        stands behind became a part of the model; draw it tighter"

    // Poses.
    SomeNotPosed { posed, photos } Usable "only {posed} of {photos} photos got a pose"
    MostNotPosed { posed, photos } NotToBeTrusted "only {posed} of {photos} photos got a pose"
    OnlyTwoPosed Usable "two photos confirm each other, and nothing confirms both (others from the same two places do \
        not): take a third from another side"
    ReprojectionError { error_px } Usable "the mean reprojection error is {error_px:.2} px; good poses are below 1 px"
    FewPoints { points, usual } Usable "{first} is held by {points} points where a usual photo has {usual}: its pose \
        may be wrong (a zoom or a crop, or too far from its neighbours); leave it out, or take photos between"
    FewMatchesKept { percent, usual_percent } Usable "{first} keeps {percent:.0} points of 100 matches where a usual \
        photo keeps {usual_percent:.0}: its matches contradict its camera (a zoom, a crop, a mirrored photo, or \
        something moved), and its shape and its neighbours' may be wrong; leave it out, or give its focal length \
        with --cameras"
    StatedFocalContradicted { stated_px, found_px } Good "the photos contradict the focal length that EXIF states: \
        {stated_px:.0} px stated, {found_px:.0} px found and used (a crop, or EXIF data of another photo)"
    GivenFocalContradicted { given_px, found_px, change_percent } Usable "a focal length of {given_px:.0} px was given \
        for {first}, the photos say {found_px:.0} px ({change_percent:+.0} %): that of another lens, zoom or size of \
        photo? Depth and normals err by per cents; correct it, or give none (--cameras, photos.focal_35mm)"

    // Light.
    LightUncalibrated Usable "the light is uncalibrated: no sphere, file or shape was given"
    LightKindContradicted Usable "the photos contradict the way that the light was said to stand (still in the world, \
        or turning with the camera): see the lighting's table"
    LightMissesPhotos { most_percent, limit_percent } Usable "shape and light miss the brightness of {names} by up to \
        {most_percent:.0} % (well-lit matte objects: below {limit_percent:.0} %): masks beside the object, gloss, \
        stains, a lamp that moved, or light from nearby; softer light from several sides helps"
    LightMissesMostPhotos { most_percent, limit_percent } NotToBeTrusted "shape and light miss the brightness of \
        {names} by up to {most_percent:.0} % (well-lit matte objects: below {limit_percent:.0} %): masks beside the \
        object, gloss, stains, a lamp that moved, or light from nearby; softer light from several sides helps"
    AlbedoNotTheSpheres { factor } Usable "the object is {factor:.2} times as bright as the light predicts, in all \
        photos alike: its albedo differs from the sphere's, or it is dirty or in its own shadow"
    LightOfOtherStrength { factor } Usable "the object is {factor:.2} times as bright as the light predicts, in all \
        photos alike: the light's strength is another, or it is dirty or in its own shadow"
    SphereSeesOtherLight { percent, best_percent } Usable "the light does not fit the object in {names} ({percent:.0} % \
        against {best_percent:.0} %): the sphere stands in the object's shadow or bounce light: move it away, or take a \
        calibration photo of a sphere in the object's place"
    CalibrationPhotoOutdated { percent, best_percent } Usable "the light does not fit the object in {names} \
        ({percent:.0} % against {best_percent:.0} %): the light changed between the calibration photo and these, or \
        their exposure did"
    ShapeMisplaced { percent, best_percent } Usable "the light does not fit the object in {names} ({percent:.0} % \
        against {best_percent:.0} %): the shape given does not lie where these photos show it, or they changed since"
    GivenLightWrong { percent, best_percent } Usable "the light does not fit the object in {names} ({percent:.0} % \
        against {best_percent:.0} %): the light given is not the light of these photos; check file, frame and exposure"
    EstimatedLightWrong { percent, best_percent } Usable "the light does not fit the object in {names} ({percent:.0} % \
        against {best_percent:.0} %): the light is an estimate; put a matte sphere beside the object"
    MuchUnexplained { limit_percent } Usable "shape and light explain less than {limit_percent:.0} % of the object to a \
        tenth in {names}: gloss, stains, or shadow and bounce light; softer light from several sides helps"

    // Shape.
    NotMatte { percent } Usable "light and pigment leave {percent:.1} % of the photos' brightness unexplained, where \
        matte objects leave 1 to 3 %: a sheen, stains, or something moved; normals err more than usual. Dull it with \
        powder or spray where that is allowed, and take larger, softer light"
    NoFineDetail { finest_px } Usable "the photos hold no detail finer than about {finest_px:.0} px (sharp ones: 2 to \
        7): they are out of focus, were moved, or were enlarged; relief is lost and normals err more. Focus, close the \
        aperture, use a tripod"
    WithoutShading Usable "the shading of {first} told nothing: its shape is what photos agree on, without fine relief"
    SeenAlone { percent } Usable "{percent:.0} % of {first} is seen by no other photo: take photos closer together"
    PartlyConfirmed { percent } Usable "several photos confirm only {percent:.0} % of the surface: it moved, it shines, \
        or the photos are too far apart"
    HardlyConfirmed { percent } NotToBeTrusted "several photos confirm only {percent:.0} % of the surface: it moved, it \
        shines, or the photos are too far apart"
    PhotoContradicted { percent, usual_percent } Usable "other photos confirm only {percent:.0} % of what {first} \
        shows, where a usual photo has {usual_percent:.0} %: the object or the lamp was moved, or its pose is wrong; \
        leave it out"
    BrightnessUneven { most_percent, least_percent } Usable "the photos disagree unevenly about how bright one place \
        is, by {most_percent:.1} % in {first} and by {least_percent:.1} % in another: the object or the lamp was moved \
        between them"

    // Cloud and mesh.
    SurfacesInLayers { apart_px } NotToBeTrusted "overlapping views lie {apart_px:.1} pixel footprints apart: their \
        surfaces form layers"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_photo_speaks_for_all_that_are_alike() {
        let kept = [("a.jpg", 30.0), ("b.jpg", 14.0), ("c.jpg", 20.0)];
        let code = |percent| FindingCode::FewMatchesKept {
            percent,
            usual_percent: 46.0,
        };
        let alone = Finding::smallest(kept.into_iter().take(1), code).unwrap();
        assert!(alone.sentence().starts_with("a.jpg keeps 30 points of 100"));
        let all = Finding::smallest(kept, code).unwrap();
        let sentence = all.sentence();
        assert!(
            sentence.starts_with("3 photos (b.jpg, c.jpg, a.jpg): b.jpg keeps 14 points of 100")
        );
        let of_all = Finding::largest([("a", 0.5), ("b", 0.7)], |_| FindingCode::PhotosMirrored);
        assert!(of_all.unwrap().sentence().starts_with("b, a: EXIF"));
        assert_eq!(Finding::largest([], code), None);
    }
}
