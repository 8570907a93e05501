"""Conventions and source keys, stated once and referred to everywhere.

Axes
    Right-handed, any length unit, axes as in the file.

Values
    Ambient occlusion and sky fractions: 1 is open, 0 is closed.

Depth count
    W(w) is the number of surfaces that the ray from the shade point along w meets; W = 0 is visible.
    The side of a face is +1 when the shade point lies in front of it (its vertices turn
    counter-clockwise as seen from the point), else -1.

Octahedral map
    A direction is projected on |x| + |y| + |z| = 1 and u = x. For fixed u the isoline is the closed
    diamond |y| + |z| = 1 - |u|. Its *loop coordinate* v in [0, 4) turns counter-clockwise about +x:
    v = 0, 1, 2, 3 at +y, +z, -y, -z, linear in (y, z) between. Great circles are straight within an
    octant; dw = (1 - |u|) du dv / r^3 with r = |(u, y, z)|.
    K isolines lie at u_k = -1 + (2k + 1) / K; strip k is the band of width 2 / K around isoline k.

Equirectangular map
    H rows of 2 H texels, the top row first. A direction lies at u = 1/2 + atan2(z, x) / (2 pi) to the right
    and v = acos(y) / pi downwards, both in [0, 1]: +y is up, the middle of the map is +x, a quarter of its
    width further right +z. Texel (r, c) is the rectangle [c, c + 1] / 2H x [r, r + 1] / H and has one
    radiance, linear, with Rec. 709 primaries.

Spherical harmonics
    Real, orthonormal, no Condon-Shortley phase: Y_lm at index l (l + 1) + m, degree 1 is +y, +z, +x.
    See core.sh. The maximum degree is L, with (L + 1)^2 coefficients.

Units
    Topology and hierarchies hold the scene multiplied by a power of two, so that its largest
    coordinate lies in [0.5, 1). That product is exact, and results do not depend on the unit.

Sources
    NBMJ14  Nowrouzezahrai, Baran, Mitchell, Jarosz 2014, Visibility Silhouettes for Semi-Analytic
            Spherical Integration.
    CIES011 CIE S 011/E:2003 (ISO 15469:2004), Spatial Distribution of Daylight: CIE Standard General Sky.
    MS42    Moon, Spencer 1942, Illumination from a Non-Uniform Sky.
    Neu74   Neumaier 1974, Rundungsfehleranalyse einiger Verfahren zur Summation endlicher Summen.
    Ward91  Ward 1991, Real Pixels (Graphics Gems II).
    HZ00    Hertzmann, Zorin 2000, Illustrating Smooth Surfaces (contours in dual space).
    PH03    Praun, Hoppe 2003, Spherical Parametrization and Remeshing (octahedral map).
    Slo13   Sloan 2013, Efficient Spherical Harmonic Evaluation.
    Slo08   Sloan 2008, Stupid Spherical Harmonics (SH) Tricks.
    HF02    Holmes, Featherstone 2002, A Unified Approach to the Clenshaw Summation and the Recursive
            Computation of Very High Degree and Order Normalised Associated Legendre Functions.
    Pau78   Paul 1978, Recurrence Relations for Integrals of Associated Legendre Functions.
    PH07    Pinchon, Hoggan 2007, Rotation Matrices for Real Spherical Harmonics.
    RH01    Ramamoorthi, Hanrahan 2001, On the Relationship between Radiance and Irradiance.
    DLMF    Digital Library of Mathematical Functions, chapter 14.
    Lam60   Lambert 1760, Photometria (vector irradiance of a polygon).
    VOS83   Van Oosterom, Strackee 1983, The Solid Angle of a Plane Triangle.
    Arv95   Arvo 1995, Applications of Irradiance Tensors to the Simulation of Non-Lambertian Phenomena.
    WR18    Wang, Ramamoorthi 2018, Analytic Spherical Harmonic Coefficients for Polygonal Area Lights.
"""
