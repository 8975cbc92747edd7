#!/bin/sh
# Opens both cameras of the guest in every format named, as the cell would, and leaves the findings in /out.
for format in "$@"; do
    sed -e "s,^device = .*_0_SIM.*,device = \"$CAM0\"," -e "s,^device = .*_1_SIM.*,device = \"$CAM1\"," \
        -e '/^controls/d' -e "s,^format = .*,format = \"$format\"," -e 's,^rate_hz = .*,rate_hz = 25.0,' \
        -e '/^pair_window_ms/d' cell.toml >"cell-$format.toml"
    ./pickcell check --cell "cell-$format.toml" --format json >"/out/$format.json" 2>"/out/$format.log"
done
