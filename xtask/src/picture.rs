//! Draws what a command printed as a terminal window, in SVG: text that stays sharp, can be searched and is diffed.

use std::fmt::Write;
use std::fs;

use crate::run::{Error, Program, root, write};

/// Where the picture of the demonstration is committed.
const DEMO: &str = "docs/demo.svg";

/// Width of a character, px: six tenths of the font size in common fonts. Every line is stretched to it, so that columns
/// line up in others too.
const CHARACTER_PX: usize = 8;

/// From one line of text to the next, px.
const LINE_PX: usize = 18;

/// Space around the text, px.
const MARGIN_PX: usize = 16;

/// Height of the window's bar, px.
const BAR_PX: usize = 32;

/// A window narrower than this many characters would cut its title.
const COLUMNS_MIN: usize = 40;

/// A tab goes on to the next multiple of this column.
const TAB_COLUMNS: usize = 8;

/// Why a text cannot be drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum PictureError {
    /// There is nothing to draw.
    #[error("there is none; run the command by hand and see why")]
    Empty,
    /// A character that moves or colours instead of standing for itself: XML has no place for it.
    #[error(
        "line {line} has the control character U+{:04X}; a program whose output is no terminal should print none",
        u32::from(*character)
    )]
    Control {
        /// Line, counted from one.
        line: usize,
        /// The character.
        character: char,
    },
}

/// Runs the demonstration and writes its picture, or only compares the one that is committed.
pub(crate) fn demo(check: bool) -> Result<(), Error> {
    let output = Program::cargo("run --quiet --release -p osap --bin osap -- demo").capture()?;
    let picture = draw("osap demo", &output)?;
    let path = root().join(DEMO);
    if !check {
        write(&path, &picture)?;
        eprintln!("wrote {DEMO}");
        return Ok(());
    }
    let committed =
        fs::read_to_string(&path).map_err(|source| Error::File { what: "read", path: path.clone(), source })?;
    if committed == picture { Ok(()) } else { Err(Error::PictureDiffers { path: DEMO.into() }) }
}

/// A terminal window in which `command` was typed and `output` came.
fn draw(command: &str, output: &str) -> Result<String, PictureError> {
    let output = output.trim_end();
    if output.is_empty() {
        return Err(PictureError::Empty);
    }
    let prompt = format!("$ {command}");
    let mut lines = vec![prompt];
    for (line, number) in output.lines().zip(1..) {
        let line = expand_tabs(line.trim_end());
        if let Some(character) = line.chars().find(|c| c.is_control()) {
            return Err(PictureError::Control { line: number, character });
        }
        lines.push(line);
    }
    let columns = lines.iter().map(|line| line.chars().count()).max().unwrap_or(0).max(COLUMNS_MIN);
    let (width, height) = (2 * MARGIN_PX + columns * CHARACTER_PX, BAR_PX + 2 * MARGIN_PX + lines.len() * LINE_PX);
    let mut svg = frame(command, width, height);
    for (line, row) in lines.iter().zip(1..).filter(|(line, _)| !line.is_empty()) {
        let class = if row == 1 { "prompt" } else { "output" };
        push_line(&mut svg, class, line, BAR_PX + MARGIN_PX + row * LINE_PX - LINE_PX / 4);
    }
    svg.push_str("</svg>\n");
    Ok(svg)
}

/// The opening of the picture: its colours, the window and the bar with its title.
fn frame(title: &str, width: usize, height: usize) -> String {
    let (middle, bar_middle, title_y, title) = (width / 2, BAR_PX / 2, BAR_PX / 2 + 4, escape(title));
    format!(
        r##"<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" role="img" aria-label="terminal: {title}">
<style>
text {{ font: 13.3px ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace; white-space: pre; }}
.title {{ fill: #8b949e; text-anchor: middle; }}
.prompt {{ fill: #7ee787; }}
.output {{ fill: #e6edf3; }}
</style>
<rect width="{width}" height="{height}" rx="8" fill="#0d1117"/>
<path d="M0 {BAR_PX}V8a8 8 0 0 1 8-8h{bar}a8 8 0 0 1 8 8v{bar_side}z" fill="#21262d"/>
<circle cx="20" cy="{bar_middle}" r="6" fill="#ff5f57"/><circle cx="40" cy="{bar_middle}" r="6" fill="#febc2e"/><circle cx="60" cy="{bar_middle}" r="6" fill="#28c840"/>
<text class="title" x="{middle}" y="{title_y}">{title}</text>
"##,
        bar = width - 16,
        bar_side = BAR_PX - 8,
    )
}

/// One line of text. Blanks in front become its place, as not every renderer keeps them.
fn push_line(svg: &mut String, class: &str, line: &str, y: usize) {
    let text = line.trim_start();
    let columns = text.chars().count();
    let x = MARGIN_PX + (line.chars().count() - columns) * CHARACTER_PX;
    let (width, text) = (columns * CHARACTER_PX, escape(text));
    // Writing to a string cannot fail.
    let _ = writeln!(
        svg,
        r#"<text class="{class}" x="{x}" y="{y}" textLength="{width}" lengthAdjust="spacingAndGlyphs" xml:space="preserve">{text}</text>"#
    );
}

fn expand_tabs(line: &str) -> String {
    let mut expanded = String::new();
    let mut column = 0;
    for character in line.chars() {
        let width = if character == '\t' { TAB_COLUMNS - column % TAB_COLUMNS } else { 1 };
        match character {
            '\t' => expanded.extend(std::iter::repeat_n(' ', width)),
            other => expanded.push(other),
        }
        column += width;
    }
    expanded
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_xml_would_take_for_itself_is_escaped() {
        let svg = draw("osap demo", "a <b> & \"c\"\n").unwrap();
        assert!(svg.contains(">a &lt;b&gt; &amp; &quot;c&quot;</text>"), "{svg}");
    }

    #[test]
    fn the_window_grows_with_columns_and_lines() {
        // two lines, with the prompt three: 32 + 2·16 + 3·18 = 118; 50 columns: 2·16 + 50·8 = 432
        let svg = draw("osap demo", &format!("a\n{}\n\n", "é".repeat(50))).unwrap();
        assert!(svg.contains(r#"width="432" height="118" viewBox="0 0 432 118""#), "{svg}");
        // no narrower than 40 columns: 2·16 + 40·8 = 352
        assert!(draw("osap demo", "a").unwrap().contains(r#"width="352" height="100""#));
    }

    #[test]
    fn a_line_is_stretched_to_its_columns_and_its_indent_becomes_its_place() {
        let svg = draw("osap demo", "x\n\n    abc\n").unwrap();
        // third row of output, fourth of the window: y = 32 + 16 + 4·18 − 4
        assert!(svg.contains(r#"x="48" y="116" textLength="24""#), "{svg}");
        assert_eq!(svg.matches(r#"class="output""#).count(), 2, "an empty line needs no element");
    }

    #[test]
    fn tabs_go_on_to_the_next_stop() {
        assert_eq!(expand_tabs("a\tb\t\tc"), "a       b               c");
    }

    #[test]
    fn what_cannot_be_drawn_is_told_with_its_line() {
        assert_eq!(draw("osap demo", " \n\n"), Err(PictureError::Empty));
        let coloured = draw("osap demo", "a\n\u{1b}[32mb\n").unwrap_err();
        assert_eq!(coloured, PictureError::Control { line: 2, character: '\u{1b}' });
        assert!(coloured.to_string().starts_with("line 2 has the control character U+001B"), "{coloured}");
    }
}
