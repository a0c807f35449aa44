"""The words of the language: for each terminal of the grammar its spellings, the canonical one first.

Case and accents do not matter. Both languages are accepted anywhere, also mixed.
"""

import unicodedata

WORDS = {
    # statements
    "NAME": "NAME NOME",
    "SAVE_RGB": "SAVE-RGB SALVA-RGB",
    "MAX_LEVEL": "MAX-LEVEL NIVEL-MAX NIVEL-MAXIMO",
    "NSAMPLES": "NSAMPLES NAMOSTRAS",
    "DO_SHADOW": "DO-SHADOW SHADOW SOMBRA SOMBRAS",
    "AIR_INDEX": "AIR-INDEX INDICE-AR",
    "AMBIENT": "AMBIENT AMBIENTE",
    "LIGHTS": "LIGHTS LUZES FONTES",
    "BACKGROUND": "BACKGROUND FUNDO",
    "VIEW": "VIEW VISTA",
    "CSG_TREE": "CSG-TREE ARVORE-CSG CSG",
    "SURFACE": "SURFACE SUPERFICIE",
    "TRANSFORM": "TRANSFORM TRANSFORMACAO",
    "TEXTURE": "TEXTURE TEXTURA",
    "END": "END FIM",
    # values
    "BOOL": "TRUE FALSE VERDADEIRO FALSO SIM NAO YES NO",
    "NULL": "NULL NULO NENHUM NENHUMA NONE",
    # lights
    "AREA": "AREA EXTENSA",
    "POINT": "POINT PONTO PONTUAL",
    "POSITION": "position posicao",
    "INTENSITY": "Intensity intensidade",
    "RADIUS": "raio radius",
    "DIRECTION": "direction direcao",
    "UNIFORM": "UNIFORM UNIFORME",
    "SPOT": "SPOT",
    "ANGLE": "angle angulo",
    "EXPONENT": "exponent expoente",
    # view
    "RESOLUTION": "RESOLUTION RESOLUCAO",
    "WINDOW": "WINDOW JANELA",
    "OBS": "OBS OBSERVER OBSERVADOR EYE OLHO",
    "VPN": "VPN",
    "VRP": "VRP",
    "VUP": "VUP",
    # primitives; CONE is also a distribution of a light
    "CUBE": "CUBE CUBO",
    "SPHERE": "SPHERE ESFERA",
    "CYLINDER": "CYLINDER CILINDRO",
    "CONE": "CONE",
    # surfaces
    "MATERIAL": "material",
    "CONDUCTOR": "condutor conductor",
    "DIELECTRIC": "dieletrico dielectric",
    "LAMBERTIAN": "lambertiano lambertian",
    "COMPOSITE": "composto composite",
    "METAL": "metal",
    "KA": "ka",
    "KD": "kd",
    "KS": "ks",
    "N_REFR": "n-refr n-refraction",
    "K_ABS": "k-abs k-absorption",
    "PHONG_N": "n",
    "RUG": "rug rugosidade roughness",
    "SLOPE": "m",
    # transforms; SCALE is also a parameter of a texture
    "SCALE": "SCALE ESCALA",
    "ROTATE_X": "ROTATE-X ROTACAO-X GIRA-X",
    "ROTATE_Y": "ROTATE-Y ROTACAO-Y GIRA-Y",
    "ROTATE_Z": "ROTATE-Z ROTACAO-Z GIRA-Z",
    "TRANSLATE": "TRANSLATE TRANSLACAO TRANSLADA",
    # textures
    "BRICK": "brick tijolo",
    "STRIPES": "stripes listra listras",
    "FRACTAL": "fractal",
    "MORTAR": "mortar argamassa",
    "BRICK_WIDTH": "brick-width largura-tijolo",
    "BRICK_HEIGHT": "brick-height altura-tijolo",
    "MORTAR_WIDTH": "mortar-width largura-argamassa",
    "STAGGER": "stagger defasagem",
    "COLOR0": "color0 cor0",
    "COLOR1": "color1 cor1",
    "FREQUENCY": "frequency frequencia",
    "DUTY": "duty razao",
    "AXIS": "axis eixo",
    "OCTAVES": "octaves oitavas",
    "GAIN": "gain ganho",
    "LACUNARITY": "lacunarity lacunaridade",
    "SEED": "seed semente",
}
WORDS = {terminal: tuple(spellings.split()) for terminal, spellings in WORDS.items()}

#: What a terminal is called in a message, where it is not a keyword.
MEANINGS = {
    "NUMBER": "a number", "WORD": "a word", "STRING": "a quoted string", "FILE": "a file name",
    "TEXTURE_NAME": "a texture's name (t-...)", "PLUS": "+", "MINUS": "-", "TIMES": "*", "LPAR": "(", "RPAR": ")",
    "BOOL": "TRUE or FALSE", "$END": "the end of the file",
}

FALSE = {"false", "falso", "nao", "no", "0"}


def fold(word):
    """Lower case without accents: the form in which words are compared."""
    if word.isascii():
        return word.lower()
    return "".join(c for c in unicodedata.normalize("NFKD", word) if not unicodedata.combining(c)).lower()


TERMINALS = {fold(spelling): terminal for terminal, spellings in WORDS.items() for spelling in spellings}


def meaning(terminal):
    """The name of a terminal in messages."""
    return MEANINGS.get(terminal) or WORDS[terminal][0]


#: Names of metals -> the tables that Mitsuba ships (Palik's handbook first: it is the thesis's own source).
METALS = {
    "copper": "Cu_palik", "cobre": "Cu_palik", "gold": "Au", "ouro": "Au", "silver": "Ag", "prata": "Ag",
    "aluminium": "Al", "aluminum": "Al", "aluminio": "Al", "chromium": "Cr", "cromo": "Cr", "nickel": "Ni_palik",
    "niquel": "Ni_palik", "tungsten": "W", "tungstenio": "W", "mercury": "Hg_palik", "mercurio": "Hg_palik",
    "beryllium": "Be_palik", "berilio": "Be_palik", "iridium": "Ir_palik", "iridio": "Ir_palik",
    "molybdenum": "Mo_palik", "molibdenio": "Mo_palik", "niobium": "Nb_palik", "niobio": "Nb_palik",
    "rhodium": "Rh_palik", "rodio": "Rh_palik", "tantalum": "Ta_palik", "tantalo": "Ta_palik",
    "vanadium": "V_palik", "vanadio": "V_palik", "sodium": "Na_palik", "sodio": "Na_palik",
    "lithium": "Li_palik", "litio": "Li_palik", "potassium": "K_palik", "potassio": "K_palik",
}
TABLES = ("Ag Al Au Be_palik Cr Cu Cu_palik Hg Hg_palik Ir Ir_palik K K_palik Li Li_palik Mo Mo_palik Na_palik Nb Nb_palik "
          "Ni_palik Rh Rh_palik Ta Ta_palik V_palik W")
METALS |= {table.lower(): table for table in TABLES.split()}
METALS |= {"na": "Na_palik", "ni": "Ni_palik", "be": "Be_palik", "v": "V_palik"}
