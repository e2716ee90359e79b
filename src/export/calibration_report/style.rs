//! What the page adds to the style of all reports: tables with links, and paper.

/// On paper black on white whatever the screen's colours are; tables and figures are not cut, but for long tables,
/// whose heads are then repeated.
pub(super) const STYLE: &str = "\
h1+p+dl{margin-top:1.4rem}h3{font-size:.95rem;font-weight:600;margin:0 0 .3rem}\
a{color:inherit;text-decoration-color:var(--dim);text-underline-offset:.15em}\
section>dl,section>ul{max-width:52rem}ul{padding-left:1.2rem;margin:0 0 1rem}\
.verdict{margin:0 0 .6rem}.verdict b,.summary b{font-weight:600}\
.bad b::before{content:'\\2715\\00a0'}.good b::before{content:'\\2713\\00a0'}.missing b::before{content:'\\2013\\00a0'}\
.missing{color:var(--dim)}.summary td:first-child{min-width:8rem}.summary td:nth-child(2){min-width:18rem}.summary td:nth-child(3){min-width:12rem}\
.summary,.figures,.shots{font-size:.86em}td,th{padding-right:1.2rem}th{vertical-align:bottom}\
th.n,td.n{text-align:right;white-space:nowrap}td.short,td.from{white-space:nowrap}\
.file{overflow-wrap:anywhere;min-width:18rem}td.words{min-width:12rem}\
.shots td{vertical-align:middle}img.thumb{width:96px;max-width:none;border-radius:0}\
tr:target td{background:var(--line)}.out td{color:var(--dim)}\
figure{margin:0 0 1.4rem}.wide{margin-bottom:1.4rem}figure .wide{margin:0}\
.chart,.map,.swatches{display:block;width:100%;height:auto}.map,.swatches{font-size:11px}\
.map text,.swatches text{fill:var(--text)}.map rect{stroke:var(--line)}.swatches .name{fill:var(--dim)}\
@media(max-width:44rem){.chart,.map,.swatches{min-width:38rem}}\
@page{size:A4;margin:15mm 14mm}\
@media print{:root{color-scheme:light;--ground:#fff;--text:#000;--dim:#333;--line:#bbb}\
body{font-size:9pt;line-height:1.35}main{max-width:none}h1{font-size:16pt}h2{font-size:12pt;break-after:avoid}\
h3{font-size:9pt;break-after:avoid}section{break-inside:auto;margin-top:6mm;padding-top:3mm}\
section>p,section>dl,section>ul{max-width:none}.verdict{break-after:avoid}\
.wide{overflow:visible;break-inside:avoid;margin-bottom:4mm}.wide.long{break-inside:auto}figure,dl,ul,tr{break-inside:avoid}\
figure{max-width:150mm;margin-bottom:4mm}thead{display:table-header-group}td,th{padding:.5mm 3mm .5mm 0}\
.shots td{padding-top:.3mm;padding-bottom:.3mm}img.thumb{width:10mm}\
.summary td:nth-child(n){min-width:0}.file{min-width:45mm}td.words{min-width:30mm}\
.missing,.out td{color:#000}a{text-decoration:none}.map rect,.swatches rect{print-color-adjust:exact}}";
