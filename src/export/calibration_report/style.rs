//! What the page adds to the style of all reports: tables with links, and paper.

/// On paper black on white whatever the screen's colours are; tables and figures are not cut, but for long tables,
/// whose heads are then repeated.
pub(super) const STYLE: &str = "\
a{color:inherit;text-decoration-color:var(--dim);text-underline-offset:.15em}\
section>dl,section>ul{max-width:52rem}ul{padding-left:1.2rem;margin:0 0 1rem}\
.verdict{margin:0 0 .6rem}.verdict b,.summary b{font-weight:600}\
.bad b::before{content:'\\2715\\00a0'}.good b::before{content:'\\2713\\00a0'}.missing b::before{content:'\\2013\\00a0'}\
.missing{color:var(--dim)}.summary td:first-child{min-width:8rem}.summary td:nth-child(2){min-width:18rem}\
caption{text-align:left;font-weight:600;padding:0 0 .3rem;font-size:.95rem}\
table{margin-bottom:.4rem}figure{margin:0 0 1.4rem}\
th.n,td.n{text-align:right;white-space:nowrap}th{vertical-align:bottom}\
td.from{white-space:nowrap}.file{overflow-wrap:anywhere;min-width:11rem}\
td,th{padding-right:1.2rem}\
.shots td{vertical-align:middle;font-size:.92em}img.thumb{width:96px;max-width:none;border-radius:0}\
tr:target td{background:var(--line)}.out td{color:var(--dim)}\
.chart,.map,.swatches{display:block;width:100%;height:auto}.map,.swatches{font-size:11px}\
.map text,.swatches text{fill:var(--text)}.map rect{stroke:var(--line)}.swatches .name{fill:var(--dim)}\
@media(max-width:44rem){.chart,.map,.swatches{min-width:38rem}}\
@page{size:A4;margin:15mm 14mm}\
@media print{:root{color-scheme:light;--ground:#fff;--text:#000;--dim:#333;--line:#bbb}\
body{font-size:9pt;line-height:1.4}main{max-width:none}h1{font-size:16pt}h2{font-size:12pt;break-after:avoid}\
section{break-inside:auto;margin-top:8mm;padding-top:4mm}section>p,section>dl,section>ul{max-width:none}\
.wide{overflow:visible}figure,table,caption,dl,tr{break-inside:avoid}caption{break-after:avoid}\
table.long{break-inside:auto}thead{display:table-header-group}td,th{padding-right:3mm}\
.shots td{padding-top:.4mm;padding-bottom:.4mm}img.thumb{width:16mm}\
.summary td:first-child,.summary td:nth-child(2),.file{min-width:0}\
.missing,.out td{color:#000}a{text-decoration:none}.map rect,.swatches rect{print-color-adjust:exact}}";
