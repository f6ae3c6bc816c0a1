"""Pictures as PNG, by matplotlib; one module for each thing that is drawn.

- `plan`: route, holes and coverage over time of a plan; which bins count
- `headings`: coverage heading by heading
- `drives`: several drives side by side
- `sensorgraph`: visibility and residuals of a sensorgraph (its faces cut into pieces in `face_pieces`)
- `identified`: a model identified by `identify`
- `style`: what all of them share

The pictures of a diagnosis are drawn in `sensorgraph.diagnosis.report`.
"""
