// Turns each picture that has data beside it into a figure to zoom into, once it comes into view.
// Without scripts, in print, and in a browser that cannot unpack the library, the pictures stay.
'use strict';
(async () => {
  const unpack = async (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream('gzip'));
    return new Response(stream).text();
  };
  const settings = {
    responsive: true, displaylogo: false, showTips: false,
    modeBarButtonsToRemove: ['select2d', 'lasso2d', 'autoScale2d'],
  };
  const draw = async (block) => {
    const chart = JSON.parse(await unpack(block.textContent));
    const figure = block.closest('figure');
    const place = document.createElement('div');
    place.className = 'plot';
    place.style.height = `${chart.height}px`;
    // Panels side by side need more than the width of a phone: the figure scrolls there.
    if (chart.layout.xaxis.domain[1] < 0.7) place.style.minWidth = '640px';
    place.setAttribute('role', 'img');
    place.setAttribute('aria-label', figure.querySelector('img').alt);
    figure.prepend(place);
    for (const key of Object.keys(chart.layout)) {
      if (/^[xy]axis/.test(key)) chart.layout[key].automargin = true;
    }
    await Plotly.newPlot(place, chart.data, chart.layout, settings);
    for (const button of place.querySelectorAll('.modebar-btn')) {
      button.tabIndex = 0;
      button.setAttribute('role', 'button');
      button.setAttribute('aria-label', button.dataset.title);
    }
    figure.classList.add('drawn');
  };
  const library = document.createElement('script');
  library.textContent = await unpack(document.getElementById('plotly').textContent);
  document.head.append(library);
  const watch = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (!entry.isIntersecting) continue;
      watch.unobserve(entry.target);
      draw(entry.target.querySelector('script[data-chart]'));
    }
  }, { rootMargin: '400px' });
  document.querySelectorAll('figure:has(script[data-chart])').forEach((it) => watch.observe(it));
  document.documentElement.dataset.charts = 'ready';
})();
addEventListener('keydown', (event) => {
  if (event.key === 'Enter' && event.target.matches('.modebar-btn')) event.target.click();
});
addEventListener('beforeprint', () => {
  document.querySelectorAll('details:not([open])').forEach((it) => {
    it.open = true;
    it.dataset.shut = '';
  });
});
addEventListener('afterprint', () => {
  document.querySelectorAll('details[data-shut]').forEach((it) => {
    it.open = false;
    delete it.dataset.shut;
  });
});
