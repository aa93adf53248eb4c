//! What the report page and the live page share: style, the view in space, and how data is put into a page.

use super::colour::ColourMap;

pub(crate) use super::stages::quantile;

/// Colours, light and dark, and the layout of both pages.
pub(crate) const STYLE: &str = include_str!("page/style.css");
/// What the pages use of three.js, which draws the view in space; its licence stands at its head. `page/vendor/three/build`
/// makes it anew.
pub(crate) const THREE: &str = include_str!("page/vendor/three/three.min.js");
/// The view in space of both pages: materials, camera, and turning by hand.
pub(crate) const SPACE: &str = include_str!("page/space.js");

/// A template with `{{name}}` replaced by the part of that name, in one pass, so that braces in a value are never
/// taken for a place to fill. A name without a part leaves nothing.
pub(crate) fn filled(template: &str, parts: &[(&str, String)]) -> String {
    let values: usize = parts.iter().map(|(_, value)| value.len()).sum();
    let mut out = String::with_capacity(template.len() + values);
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        out.push_str(before);
        let (name, after) = after.split_once("}}").unwrap_or((after, ""));
        if let Some((_, value)) = parts.iter().find(|(part, _)| *part == name) {
            out.push_str(value);
        }
        rest = after;
    }
    out.push_str(rest);
    out
}

/// The 256 colours of a map, as red, green and blue in sRGB.
pub(crate) fn colours(map: ColourMap) -> Vec<u8> {
    (0..=255_u8)
        .flat_map(|i| map.colour(f64::from(i) / 255.0).to_srgb())
        .collect()
}

/// Text for HTML.
pub(crate) fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            _ => out.push(character),
        }
    }
    out
}

/// Base 64 (RFC 4648) with padding.
pub(crate) fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for group in bytes.chunks(3) {
        let bits = (0..3).fold(0_u32, |bits, i| {
            bits << 8 | u32::from(group.get(i).copied().unwrap_or(0))
        });
        for digit in 0..4 {
            if digit <= group.len() {
                out.push(char::from(DIGITS[(bits >> (18 - 6 * digit) & 63) as usize]));
            } else {
                out.push('=');
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_follows_the_standard() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
        assert_eq!(base64(&[0xFB, 0xFF]), "+/8=");
    }

    /// What was made by `page/vendor/three/build` has not been changed by hand, carries its whole licence, and can stand in a
    /// page.
    #[test]
    fn library_of_the_view_is_the_one_that_was_made_and_carries_its_licence() {
        let made = crate::export::Origin::of_bytes("three.min.js", THREE.as_bytes());
        let sum = include_str!("page/vendor/three/three.sha256");
        assert_eq!(sum.trim(), format!("{}  three.min.js", made.sha256));
        let head = THREE.split_once("*/").unwrap().0;
        assert!(head.contains(include_str!("page/vendor/three/LICENSE").trim()));
        assert!(!THREE.contains("</script") && !THREE.contains("<!--"));
    }

    #[test]
    fn values_are_never_taken_for_places() {
        let parts = [("a", "{{b}}".to_owned()), ("b", "x".to_owned())];
        assert_eq!(filled("<{{a}}|{{b}}|{{c}}>", &parts), "<{{b}}|x|>");
        assert_eq!(filled("open {{a", &parts), "open {{b}}");
    }
}
