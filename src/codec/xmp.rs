//! XMP sidecars of original frames (ISO 16684-1), for programs that sort photographs: what the checks said of the pair.
//!
//! A sidecar has its raw's name with the ending `.xmp` (`off.xmp` beside `off.cr2`): so Lightroom, Bridge, Camera Raw and
//! Capture One name theirs, and darktable and digiKam read that too. `xmp:Rating` -1 is the standard's word for rejected.
//! Labels are free text; "Red" is the one that most programs show as a colour.

use super::markup::escape;
use crate::pair::{PairRecord, Verdict};

/// Our own properties.
const NAMESPACE: &str = "https://unlit.invalid/ns/pair/1.0/";

/// The sidecar of a frame; `role` says which (`off`, `on`).
pub fn sidecar(pair: &PairRecord, role: &str) -> String {
    let rejected = pair.verdict == Verdict::Rejected;
    let rating = if rejected { "\n    xmp:Rating=\"-1\"\n    xmp:Label=\"Red\"" } else { "" };
    let verdict = if rejected { "rejected" } else { "accepted" };
    let sentences: Vec<&str> = pair.reasons.iter().map(|reason| reason.sentence.as_str()).collect();
    let description = match sentences.as_slice() {
        [] => format!("Pair {}, frame {role}: accepted.", pair.name),
        sentences => format!("Pair {}, frame {role}: rejected. {}", pair.name, sentences.join(" ")),
    };
    let codes = pair.reasons.iter().filter_map(|reason| serde_json::to_value(reason.code).ok());
    let items: String = codes
        .filter_map(|code| code.as_str().map(|code| format!("\n      <rdf:li>{}</rdf:li>", escape(code))))
        .collect();
    let reasons = if items.is_empty() {
        String::new()
    } else {
        format!("\n   <unlit:Reasons>\n    <rdf:Bag>{items}\n    </rdf:Bag>\n   </unlit:Reasons>")
    };
    format!(
        r#"<?xpacket begin="{bom}" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/" x:xmptk="unlit {version}">
 <rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
  <rdf:Description rdf:about=""
    xmlns:xmp="http://ns.adobe.com/xap/1.0/"
    xmlns:dc="http://purl.org/dc/elements/1.1/"
    xmlns:unlit="{NAMESPACE}"{rating}
    unlit:Pair="{number}"
    unlit:Name="{name}"
    unlit:Frame="{role}"
    unlit:Verdict="{verdict}">
   <dc:description>
    <rdf:Alt>
     <rdf:li xml:lang="x-default">{description}</rdf:li>
    </rdf:Alt>
   </dc:description>{reasons}
  </rdf:Description>
 </rdf:RDF>
</x:xmpmeta>
<?xpacket end="w"?>
"#,
        bom = '\u{feff}',
        version = env!("CARGO_PKG_VERSION"),
        number = pair.number,
        name = escape(&pair.name),
        role = escape(role),
        description = escape(&description),
    )
}
