// Opens every page in frames of two widths and uses it as a reader does; a line for each fault.
const widths = [390, 1440];
const faults = [];
let opened = 0;
let checks = 0;
let rods = 0;

const load = (page, width) => new Promise((resolve) => {
    const frame = document.createElement('iframe');
    frame.width = width;
    frame.height = 1000;
    frame.style.border = 0;
    frame.onload = () => resolve(frame);
    frame.src = '/' + page;
    document.body.replaceChildren(frame);
});

const wait = (milliseconds) => new Promise((resolve) => setTimeout(resolve, milliseconds));

// Waits until something is so, five seconds at most.
async function until(test) {
    for (let i = 0; i < 100; i++) {
        if (test()) return true;
        await wait(50);
    }
    return false;
}

// A number for what a canvas shows; 0 for one colour only.
function shown(canvas) {
    const small = document.createElement('canvas');
    [small.width, small.height] = [160, 100];
    const pen = small.getContext('2d', { willReadFrequently: true });
    pen.drawImage(canvas, 0, 0, 160, 100);
    const pixels = pen.getImageData(0, 0, 160, 100).data;
    let hash = 0;
    let same = true;
    for (let i = 0; i < pixels.length; i++) {
        hash = (hash * 31 + pixels[i]) | 0;
        same = same && pixels[i] === pixels[i % 4];
    }
    return same ? 0 : hash;
}

// Ratio of the luminances of two colours, as WCAG 2.1 defines it.
function contrast(a, b) {
    const luminance = (text) => {
        const [red, green, blue] = text.match(/[0-9.]+/g).map(Number).map((v) => v / 255)
            .map((v) => (v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
    };
    const [x, y] = [luminance(a), luminance(b)];
    return (Math.max(x, y) + 0.05) / (Math.min(x, y) + 0.05);
}

async function look(page, width) {
    const frame = await load(page, width);
    const view = frame.contentWindow;
    const doc = frame.contentDocument;
    opened += 1;
    const check = (good, what) => {
        checks += 1;
        if (!good) faults.push(`${page} at ${width} px: ${what}`);
    };
    const all = (selector) => Array.from(doc.querySelectorAll(selector));
    const visible = (element) => element.offsetParent !== null && element.clientWidth > 0;
    const key = (element, name) =>
        element.dispatchEvent(new view.KeyboardEvent('keydown', { key: name, bubbles: true, cancelable: true }));

    // ---- the page
    check(doc.documentElement.lang === 'en' && doc.title.length > 8, 'no language or title');
    check(all('h1').length === 1, 'not one heading of the first rank');
    check(doc.querySelector('main > header').nextElementSibling.matches('.verdict'), 'the verdict is not first');
    check(view.performance.getEntriesByType('resource').length === 0, 'it loads something');
    const ids = all('[id]').map((e) => e.id);
    check(new Set(ids).size === ids.length, 'two elements with one name');
    check(doc.documentElement.scrollWidth <= width + 1, `wider than the window: ${doc.documentElement.scrollWidth}`);
    const cut = all('main .tile, main td, main h2, main p').filter((e) => visible(e) && !e.closest('.scroll, pre')
        && e.getBoundingClientRect().right > width + 1);
    check(cut.length === 0, `cut: ${cut.length && cut[0].textContent.slice(0, 40)}`);
    const card = view.getComputedStyle(doc.querySelector('.verdict')).backgroundColor;
    const faint = all('main p, main td, main th, main dd, main dt, figcaption').filter((e) => e.textContent.trim()
        && visible(e) && contrast(view.getComputedStyle(e).color, card) < 4.5);
    check(faint.length === 0, `too faint: ${faint.length && faint[0].textContent.slice(0, 40)}`);
    const small = all('main p, main td, main dd').filter((e) => visible(e)
        && parseFloat(view.getComputedStyle(e).fontSize) < 12);
    check(small.length === 0, `text below 12 px: ${small.length && small[0].textContent.slice(0, 40)}`);
    const nameless = all('button, select, input, canvas[tabindex], svg[role], [role=img]').filter((e) =>
        !(e.getAttribute('aria-label') || e.textContent.trim() || (e.labels && e.labels.length)));
    check(nameless.length === 0, `no name: ${nameless.length && nameless[0].outerHTML.slice(0, 80)}`);
    const folded = all('details');
    folded.forEach((d) => { d.open = true; });
    await wait(50);
    check(doc.documentElement.scrollWidth <= width + 1, 'wider than the window once unfolded');
    folded.forEach((d) => { d.open = false; });

    // ---- charts
    const charts = all('.chart').filter(visible);
    const data = view.varda ? view.varda.data : { charts: [], rod: null };
    check(await until(() => charts.every((c) => c.querySelector('canvas'))), 'a chart is not drawn');
    await wait(100);
    const blank = charts.flatMap((c) => Array.from(c.querySelectorAll('canvas'))).filter((c) => shown(c) === 0);
    check(blank.length === 0, `a chart is blank: ${blank.length && blank[0].closest('.chart').id}`);
    charts.forEach((chart) => {
        const figure = data.charts[Number(chart.id.slice(6))];
        check(chart.querySelectorAll('canvas').length === figure.panels.length, `${chart.id}: panels are missing`);
        chart.querySelectorAll('.u-wrap').forEach((plot) => {
            const legend = plot.parentElement.querySelector('.u-legend').getBoundingClientRect();
            check(legend.top >= plot.getBoundingClientRect().bottom - 1, `${chart.id}: the legend is on the data`);
        });
    });
    const name = charts.length && charts[0].querySelector('.u-legend .u-series:nth-child(2) th');
    if (name) {
        const row = name.parentElement;
        key(name, 'Enter');
        check(row.classList.contains('u-off'), 'Enter on a name of a legend does not hide its curve');
        key(name, 'Enter');
    }
    all('.one-of').filter((f) => f.querySelectorAll('option').length > 1).forEach((figure) => {
        const select = figure.querySelector('select');
        select.selectedIndex = select.options.length - 1;
        select.dispatchEvent(new view.Event('change'));
    });
    await wait(150);
    all('.one-of select').forEach((select) => {
        const chart = doc.getElementById(select.value);
        check(visible(chart) && chart.querySelector('canvas') && shown(chart.querySelector('canvas')) !== 0,
            `the choice ${select.id} shows nothing`);
    });

    // ---- the rod
    if (data.rod) {
        rods += 1;
        const canvas = doc.querySelector('#rod canvas');
        check(canvas && shown(canvas) !== 0, 'the rod is not drawn');
        if (canvas) {
            const { rod } = view.varda;
            const change = (what, act) => {
                const before = shown(canvas);
                act();
                check(shown(canvas) !== before, what);
            };
            change('the left arrow does not turn the rod', () => key(canvas, 'ArrowLeft'));
            change('the upper arrow does not turn the rod', () => key(canvas, 'ArrowUp'));
            change('plus does not zoom', () => key(canvas, '+'));
            change('Home does not return', () => key(canvas, 'Home'));
            const box = canvas.getBoundingClientRect();
            const pointer = (type, x, y) => canvas.dispatchEvent(new view.PointerEvent(type, {
                pointerId: 1, pointerType: 'mouse', button: 0, buttons: 1, bubbles: true, isPrimary: true,
                clientX: box.left + x, clientY: box.top + y, pageX: box.left + x, pageY: box.top + y,
            }));
            canvas.setPointerCapture = () => {};
            canvas.releasePointerCapture = () => {};
            const before = shown(canvas);
            pointer('pointerdown', 100, 100);
            pointer('pointermove', 180, 130);
            pointer('pointerup', 180, 130);
            await wait(60);
            check(shown(canvas) !== before, 'dragging does not turn the rod');
            const slider = doc.getElementById('rod-time');
            const last = Number(slider.max);
            if (last > 0) {
                const clock = doc.getElementById('rod-clock');
                change('the slider does not move the rod', () => {
                    slider.value = Math.ceil(last / 3);
                    slider.dispatchEvent(new view.Event('input'));
                });
                check(clock.textContent.includes('s'), 'no time is shown');
                const from = rod.frame();
                doc.getElementById('rod-play').click();
                check(rod.playing(), 'Play does not play');
                check(await until(() => rod.frame() > from), 'time stands still while it plays');
                key(canvas, ' ');
                check(!rod.playing(), 'the space bar does not stop it');
            }
            for (const layer of ['analysis', 'tube']) {
                const box = doc.getElementById('rod-' + layer);
                if (box) {
                    change(`the layer ${layer} cannot be hidden`, () => box.click());
                    box.click();
                }
            }
            const colour = doc.getElementById('rod-colour');
            if (data.rod.colours.length) {
                change('colours do not change', () => {
                    colour.selectedIndex = colour.options.length - 1;
                    colour.dispatchEvent(new view.Event('change'));
                });
                check(visible(doc.querySelector('#rod .scale')), 'no scale of colours');
            }
        }
    }
    const errors = view.varda ? view.varda.errors : [];
    check(errors.length === 0, `errors: ${errors.join('; ')}`);
}

window.onload = async () => {
    for (const page of pages) {
        for (const width of widths) {
            try {
                await look(page, width);
            } catch (error) {
                faults.push(`${page} at ${width} px: the check ended: ${error}`);
            }
        }
    }
    const seen = `${opened} views of pages, ${checks} checks, ${rods} views of rods`;
    await fetch('/report', { method: 'POST', body: faults.concat([seen]).join('\n') });
};
